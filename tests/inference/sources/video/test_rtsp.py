"""RTSP servers that answer what makes no sense, or nothing: each ends in a stream that is lost."""

import re
import select
import socket
import struct
import threading
import time
from base64 import b64encode
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from tokt.inference.sources.video.address import VideoAddress
from tokt.inference.sources.video.newest import Reading, StreamLostError
from tokt.inference.sources.video.rtp import Delay
from tokt.inference.sources.video.rtsp import _Packets, read_rtsp

from .encoding import encode
from .packets import nal_units, rtp_packets, sdp
from .reading import Newest

OK = "RTSP/1.0 200 OK\r\n"
SDP = sdp(0).replace("c=IN", "a=control:*\r\nc=IN")
DESCRIBED = f"Content-Type: application/sdp\r\nContent-Length: {len(SDP)}\r\n\r\n{SDP}"
ANSWERS = {
    "OPTIONS": f"{OK}Public: DESCRIBE, SETUP, PLAY, TEARDOWN\r\n\r\n",
    "DESCRIBE": OK + DESCRIBED,
    "SETUP": f"{OK}Session: 1\r\nTransport: {{transport}}\r\n\r\n",
    "PLAY": f"{OK}Session: 1\r\n\r\n",
}


@contextmanager
def server(answers=None, played=lambda connection, ports: None):
    """Answers each request as told, numbered; `played` has the connection from PLAY on."""
    answers = {**ANSWERS, **(answers or {})}

    def serve():
        with suppress(OSError):
            while True:
                connection, _ = listening.accept()
                with connection, suppress(OSError):
                    answer(connection)

    def answer(connection):
        ports = None
        while request := connection.recv(1 << 16).decode():
            method, number = request.split()[0], re.search(r"CSeq: (\d+)", request)[1]
            asked = re.search(r"Transport: (.*)", request)
            if found := re.search(r"client_port=(\d+)-(\d+)", request):
                ports = int(found[1]), int(found[2])
            told = answers.get(method, OK + "\r\n")
            if callable(told):
                told(connection)
                continue
            told = told.replace("{transport}", asked[1].strip() if asked else "")
            connection.sendall(told.replace("\r\n", f"\r\nCSeq: {number}\r\n", 1).encode())
            if method in ("PLAY", "GET_PARAMETER"):
                played(connection, ports)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield listening.getsockname()[1]
        listening.shutdown(socket.SHUT_RDWR)
    thread.join()


def endless(head):
    """Sends a beginning, and then more of the same until nobody listens."""

    def send(connection):
        connection.sendall(head)
        while True:
            connection.sendall(b"X-More: and more\r\n" * 100)
            time.sleep(0.01)

    return send


HOSTILE = {
    "a redirect": {"DESCRIBE": "RTSP/1.0 302 Moved\r\nLocation: rtsp://127.0.0.1:1/x\r\n\r\n"},
    "no number": {"DESCRIBE": "RTSP/1.0 many OK\r\n\r\n"},
    "no sense": {"OPTIONS": "HTTP/1.1 200 OK\r\n\r\n"},
    "no methods": {"OPTIONS": OK + "\r\n"},
    "a body too long": {"DESCRIBE": OK + "Content-Length: 99999999\r\n\r\n" + "x" * 70_000},
    "a body of no text": {"DESCRIBE": lambda it: it.sendall(b"RTSP/1.0 200 \xff\xfe\r\n\r\n")},
    "no video": {"DESCRIBE": OK + "Content-Length: 4\r\n\r\nv=0\n"},
    "another codec": {"DESCRIBE": (OK + DESCRIBED).replace("H264", "JPEG")},
    "other channels": {
        "SETUP": f"{OK}Session: 1\r\nTransport: RTP/AVP/TCP;interleaved=4-5\r\n\r\n"
    },
    "no session": {"SETUP": f"{OK}Transport: {{transport}}\r\n\r\n"},
    "an unknown digest": {
        "OPTIONS": "RTSP/1.0 401 No\r\nWWW-Authenticate: Digest realm=a, nonce=b, "
        "algorithm=MD5-sess\r\n\r\n"
    },
    "an empty digest": {"OPTIONS": "RTSP/1.0 401 No\r\nWWW-Authenticate: Digest \r\n\r\n"},
    "never satisfied": {"OPTIONS": 'RTSP/1.0 401 No\r\nWWW-Authenticate: Basic realm="a"\r\n\r\n'},
    "it hangs up": {"DESCRIBE": lambda it: it.shutdown(socket.SHUT_RDWR)},
    "a head without an end": {"OPTIONS": endless(OK.encode())},
    "a line without an end": {"OPTIONS": lambda it: endless(b"RTSP/1.0")(it)},
    "a play that is refused": {"PLAY": "RTSP/1.0 455 No\r\n\r\n"},
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_answers_that_make_no_sense(kind, monkeypatch):
    monkeypatch.setattr("tokt.inference.sources.video.rtsp._ANSWER_S", 0.5)
    with server(HOSTILE[kind]) as port, pytest.raises(StreamLostError) as caught:
        read_rtsp(VideoAddress.parse(f"rtsp://pilot:secret@127.0.0.1:{port}/x"), Newest())
    assert "secret" not in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("scheme", ["rtsp", "rtspu"])
def test_what_ends_a_stream_ends_its_session(scheme):
    """Another sender, of other parameter sets than the description's."""
    film = encode("h264", 10)
    sets = ",".join(b64encode(unit).decode() for unit in nal_units(film[0].data) if unit[0] & 8)
    described = SDP.replace("mode=1", f"mode=1;sprop-parameter-sets={sets}")
    head = f"Content-Type: application/sdp\r\nContent-Length: {len(described)}\r\n\r\n"

    def played(connection, ports):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for seq in range(0, 60_000, 100):
                for packet in rtp_packets(film, ssrc=1 + bool(seq), seq=seq):
                    if ports:
                        out.sendto(packet.data, ("127.0.0.1", ports[0]))
                    else:
                        connection.sendall(struct.pack("!cBH", b"$", 0, len(packet.data)))
                        connection.sendall(packet.data)
                time.sleep(0.05)
                if select.select([connection], [], [], 0)[0]:
                    return  # it is asked to end

    newest = Newest()
    with server({"DESCRIBE": OK + head + described}, played) as port:
        timer = threading.Timer(20.0, newest.stopped.set)
        timer.start()
        with pytest.raises(StreamLostError, match="another sender"):
            read_rtsp(VideoAddress.parse(f"{scheme}://127.0.0.1:{port}/x"), newest)
        timer.cancel()


def test_a_server_that_refuses_to_be_asked_goes_on_being_shown():
    newest, film, asked = Newest(), encode("h264", 10), []

    def played(connection, ports):
        asked.append(ports)
        for seq in range(0, 60_000, 100):
            for packet in rtp_packets(film, seq=seq, timestamp=seq * 3000):
                connection.sendall(struct.pack("!cBH", b"$", 0, len(packet.data)) + packet.data)
            time.sleep(0.05)
            if select.select([connection], [], [], 0)[0]:
                return
            if len(asked) > 2:
                newest.stopped.set()

    options = ANSWERS["OPTIONS"].replace("PLAY", "PLAY, GET_PARAMETER")
    setup = ANSWERS["SETUP"].replace("Session: 1", "Session: 1;timeout=1")
    refused = "RTSP/1.0 501 No\r\n\r\n"
    answers = {"OPTIONS": options, "SETUP": setup, "GET_PARAMETER": refused}
    with server(answers, played) as port:
        read_rtsp(VideoAddress.parse(f"rtsp://127.0.0.1:{port}/x"), newest)
    assert newest.take(0) and len(asked) == 3


@pytest.mark.parametrize(
    ("heard", "first"),
    [
        # The pictures since the last key picture come at once, then one after the other.
        (lambda number: 2.0 + 0.005 * number if number < 60 else number / 30 + 0.31, 67),
        (lambda number: number / 60, 241),  # a clock that is twice as fast as the pictures come
    ],
)
def test_what_a_server_had_kept_is_not_shown_as_fresh(heard, first):
    packets, delay, shown = _Packets(), Delay(), []
    packets.newest = Newest()
    packets.newest.put = lambda reading: shown.append(round(reading.taken_s * 30))
    for number in range(300):
        packets.heard = heard(number)
        at = delay.undelayed(number / 30, packets.heard)
        packets.put([Reading(np.zeros((2, 2), np.uint8), at, taken_s=number / 30)])
    assert shown == list(range(first, 300))
