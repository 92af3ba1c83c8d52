"""A live view as its clients see it: real sockets, and what the pictures say in their headers."""

import http.client
import json
import os
import socket
import time
from contextlib import ExitStack, contextmanager
from urllib.parse import quote

import cv2
import numpy as np

from tests.inference.conftest import NoiseScorer, draw
from tests.inference.live import HandSource
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.outputs.view import LiveView, listening, view_url
from tokt.inference.policy.object_naming import ObjectNaming
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.policy.temporal_cues import TemporalCues
from tokt.inference.publisher import ReportPublisher
from tokt.inference.texture.detector import TextureDetector

LONG = Limits(stale_s=MAX_S, heartbeat_s=MAX_S)
"""Nothing is old while a busy machine takes its time."""


_FRAME_S = 0.03
"""Between two frames, as a camera gives them: else a wait would keep a processor busy."""


def ask(port, path, method="GET", **headers):
    """One request: status, headers, body; 0 where the connection was closed."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=MAX_S)
    try:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()
    except (ConnectionError, http.client.HTTPException):
        return 0, {}, b""
    finally:
        connection.close()


class Viewed:
    """A live view, and a hand that shows it frames."""

    def __init__(self, limits=LONG, token=None, record=None, served=True):
        self.token = token
        self.events, self.source, self.clients = [], HandSource(), ExitStack()
        self.policy = TemporalCues(SinglePolicy(TextureDetector(NoiseScorer())))
        self.naming = ObjectNaming(self.policy, SYSTEM_CLOCK.time)
        self.publisher = ReportPublisher([], SYSTEM_CLOCK, limits, live=True)
        listener = listening("127.0.0.1", 0) if served else None
        self.port = listener.getsockname()[1] if served else 0
        self.url = view_url("127.0.0.1", self.port, token)
        told = limits.stale_s, self.events.append, self.naming
        self.view = LiveView(listener, token, record, *told)

    def see(self, patches=(), left=None, age_s=0.0):
        """Have a frame judged, at a camera's pace; its report."""
        time.sleep(_FRAME_S)
        number = self.source._number
        left = draw(list(patches), number % 50) if left is None else left
        frame = self.source.frame(left, age_s)
        self.events += self.naming.take()
        self.publisher.begin(frame)
        judgement = self.policy.judge(frame)
        report = self.publisher.publish(frame, judgement)
        self.view.judged(frame, judgement, report)
        return report

    def until_shown(self, word, patches=(), **more):
        """Show frames until the view says that word; its words and the picture."""

        def look():
            self.see(patches, **more)
            status, headers, body = self.get(f"/picture?token={quote(self.token or '')}")
            words = json.loads(headers["X-Tokt"]) if status == 200 else {"word": status}
            return (words, decoded(body)) if words["word"] == word else None

        return until(look)

    @property
    def child(self):
        """The process that draws, once it does."""
        return until(lambda: self.view._process and self.view._process.pid)

    def signal(self, number):
        """To the process that draws."""
        os.kill(self.child, number)

    def get(self, path, method="GET", **headers):
        return ask(self.port, path, method, **headers)

    def connect(self, said=b""):
        """A socket that said that."""
        opened = socket.create_connection(("127.0.0.1", self.port), timeout=MAX_S)
        self.clients.callback(opened.close)
        opened.sendall(said)
        return opened


@contextmanager
def viewed(*arguments, **options):
    """A live view that is closed, whatever became of its process."""
    made = Viewed(*arguments, **options)
    try:
        yield made
    finally:
        made.view.close()
        made.clients.close()


def decoded(jpeg):
    """A picture's pixels, BGR."""
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


STREAM = b"GET /stream.mjpg HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n"


def stream_parts(opened, find):
    """Read a stream until `find` gives something of a picture; that, and how many it took."""
    data, pictures = b"", 0
    while True:
        more = opened.recv(65_536)
        assert more, "the stream ended"
        data += more
        while (end := data.find(b"\xff\xd9\r\n--frame")) >= 0:
            pictures += 1
            found = find(data[data.index(b"\xff\xd8") : end + 2])
            data = data[end + 2 :]
            if found:
                return found, pictures
