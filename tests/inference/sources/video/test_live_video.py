"""Live streams of real servers through the camera's own process: paused, started anew, lost."""

import contextlib
import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.calls import call_tokt, refuses
from tests.inference.live import bound_socket, start_tokt
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.inference.sources.cameras.process_driver import ProcessDriver
from tokt.inference.sources.open import open_camera_source

from . import senders
from .pictures import number_of
from .senders import FILM, Film, free_port, needs_ffmpeg, needs_gst, needs_gst_rtsp


class Watched:
    """The frames of a source as they come, by their pictures' numbers, and its events."""

    def __init__(self, url, **options):
        self.events, self.frames, self.numbers = [], [], []
        config = SourceConfig(source=url, wait=True, **options)
        self.source = open_camera_source(config, SYSTEM_CLOCK, self.events.append)
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self):
        for frame in self.source:
            number = None if frame.left is None else number_of(frame.left)
            assert frame.left is None or number is not None, "a picture that cannot be read"
            self.frames.append((frame, number))
            self.numbers.append(number)

    def shown(self):
        return [number for number in self.numbers if number is not None]

    def reasons(self):
        return [frame.left_fault.reason for frame, _ in self.frames if frame.left is None]

    def process(self):
        return self.source.drivers[0]._process

    def close(self):
        self.source.close()
        self._thread.join()


@contextlib.contextmanager
def watched(url, **options):
    seen = Watched(url, **options)
    try:
        yield seen
    finally:
        seen.close()


SENDERS = [
    pytest.param("ffmpeg_rtp", "", "h264", marks=needs_ffmpeg),
    pytest.param("gst_rtp", "", "h265", marks=needs_gst),
    pytest.param("rtsp", "rtsp:", "h264", marks=needs_gst_rtsp),
    pytest.param("rtsp", "rtspu:", "h265", marks=needs_gst_rtsp),
]


@pytest.mark.parametrize(("name", "scheme", "codec"), SENDERS)
def test_a_sender_that_hangs_and_begins_anew(name, scheme, codec, tmp_path):
    with getattr(senders, name)(tmp_path, Film(codec=codec, key_every=10)) as sender:
        url = scheme + sender.url.partition(":")[2] if scheme else sender.url
        with watched(url) as seen:
            until(lambda: len(seen.shown()) > 10)
            shown = seen.shown()
            assert shown == sorted(set(shown))
            before = len(seen.events)  # a busy machine may pause it as well
            sender.pause()
            until(lambda: [event.name for event in seen.events][before:][-1:] == ["camera_lost"])
            until(lambda: seen.reasons()[-1:] == [Reason.CAMERA_LOST])
            sender.resume()
            until(lambda: seen.events[-1].name == "camera_back")
            count = len(seen.shown())
            until(lambda: len(seen.shown()) > count + 10)
            sender.restart()
            count, last = len(seen.shown()), max(seen.shown())
            until(lambda: len(seen.shown()) > count + 10 and max(seen.shown()) > last)


@needs_ffmpeg
def test_a_key_picture_is_waited_for_longer_than_any_silence(tmp_path):
    with senders.ffmpeg_rtp(tmp_path, Film(rate=15, key_every=75)) as sender:
        until(lambda: sender.stamps.last() > 5)
        with watched(sender.url) as seen:
            until(lambda: len(seen.shown()) > 3)
            assert seen.shown()[0] % 75 <= 1  # their numbers begin at 0 or 1
            assert "the stream is joined" in str(seen.frames[3][0].left_fault)


@needs_ffmpeg
def test_the_process_that_reads_dies_or_hangs(tmp_path):
    with senders.ffmpeg_rtp(tmp_path) as sender, watched(sender.url) as seen:
        until(lambda: len(seen.shown()) > 5)
        for fault in (signal.SIGKILL, signal.SIGSTOP):
            count, lost = len(seen.shown()), seen.reasons().count(Reason.CAMERA_LOST)
            os.kill(seen.process().pid, fault)
            until(lambda: seen.reasons().count(Reason.CAMERA_LOST) > lost)  # noqa: B023
            until(lambda: len(seen.shown()) > count + 5)  # noqa: B023


@needs_ffmpeg
def test_two_streams_are_a_pair_and_one_can_hold_both(tmp_path):
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    left, right = (senders.ffmpeg_rtp(tmp_path / name) for name in "ab")
    with left, right, watched(f"{left.url},{right.url}") as seen:
        until(lambda: sum(frame.right is not None for frame, _ in seen.frames) > 5)
    with senders.ffmpeg_rtp(tmp_path, Film(size=(640, 240))) as sender:
        both = opened(sender.url, split="left-right")
        frame = next(frame for frame in both if frame.left is not None)
        both.close()
        assert frame.left.shape == frame.right.shape == (240, 320, 3)
        assert (frame.left != frame.right).any()


def opened(url, **options):
    return open_camera_source(SourceConfig(source=url, **options), SYSTEM_CLOCK, print)


def test_what_cannot_be_opened():
    """At the same time: each is tried for 8 s."""
    refuses("--split is left-right", opened, "rtp://:1", split="x")
    port = free_port()
    wrong = {
        f"rtp://127.0.0.1:{port}": f"source rtp://127.0.0.1:{port}: nothing has come",
        f"rtsp://u:secret@127.0.0.1:{port}/x": "no RTSP session",
    }
    with ThreadPoolExecutor() as pool:
        assert all(pool.map(lambda url: refuses(wrong[url], opened, url), wrong))


@needs_gst_rtsp
def test_a_password(tmp_path, monkeypatch):
    """Basic; digest is asked for in the next test."""
    monkeypatch.setenv("TOKT_SOURCE_USER", "pilot")
    monkeypatch.setenv("TOKT_SOURCE_PASSWORD", "secret")
    with senders.rtsp(tmp_path, FILM, "pilot", "secret", "basic") as server:
        with watched(server.url.replace("pilot:secret@", "")) as seen:
            until(lambda: len(seen.shown()) > 2)
        assert isinstance(seen.source.drivers[0], ProcessDriver)
        refuses("401.*user and a password", opened, server.url.replace("secret", "wrong"))


@needs_gst_rtsp
def test_the_real_runtime_judges_a_stream_and_keeps_its_password(bundle_file, tmp_path):
    log = tmp_path / "log.jsonl"
    film = Film(size=(360, 272))
    with senders.rtsp(tmp_path, film, "pilot", "secret") as server, bound_socket() as receiver:
        udp = f"v2@127.0.0.1:{receiver.getsockname()[1]}"
        options = ("--bundle", bundle_file, "--policy", "texture", "--log", log, "--udp", udp)
        process = start_tokt("run", "--source", server.url, *options)
        try:
            said = [decode(receiver.recv(2000)) for _ in range(10)]
            assert any(each["sight"] for each in said), said[-1]["health"]
            process.send_signal(signal.SIGTERM)
            assert process.wait(MAX_S) == 0
        finally:
            process.kill()
            out = "".join(part or "" for part in process.communicate()).encode()
        kept = out + b"".join(path.read_bytes() for path in tmp_path.glob("log*"))
        assert b"secret" not in kept and b"/video" in kept
        printed = call_tokt("run", "--source", server.url, "--print-config").out
        assert "secret" not in printed and "/video" in printed
