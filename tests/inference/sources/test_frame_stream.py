import json
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.calls import refused, refuses
from tests.inference.live import bound_socket, start_tokt
from tests.inference.test_faults import hold_row
from tests.tiers import scaled
from tests.waiting import MAX_S
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.outputs.udp import decode
from tokt.inference.sources.stream import MAX_HEADER, MAX_SIDE, StreamSource, encode_frame


@contextmanager
def sending(*parts: bytes) -> Iterator[str]:
    """A program that sends these bytes, one after the other, and ends the stream."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def send() -> None:
            connection, _ = server.accept()
            with connection:
                for part in parts:
                    connection.sendall(part)

        thread = threading.Thread(target=send)
        thread.start()
        yield f"stream:127.0.0.1:{server.getsockname()[1]}"
        thread.join()


def received(*parts: bytes) -> list[Frame]:
    with sending(*parts) as where, closing(StreamSource(where, SYSTEM_CLOCK)) as source:
        return list(source)


SIDES = st.integers(1, 9)
SHAPES = st.tuples(SIDES, SIDES) | st.tuples(SIDES, SIDES, st.just(3))
PICTURES = st.none() | arrays(np.uint8, SHAPES)
NUMBERS, TIMES = st.integers(0, 10**9), st.floats(0, 2e9)
FRAMES = st.tuples(NUMBERS, TIMES, PICTURES, PICTURES, st.integers(0, 1_000_000))


@settings(max_examples=scaled(25))
@given(frames=st.lists(FRAMES, max_size=4), cut=st.integers(1, 50))
def test_what_is_sent_is_what_comes(frames, cut):  # type: ignore[type-arg]
    numbers, times = sorted({frame[0] for frame in frames}), sorted(frame[1] for frame in frames)
    frames = [(*now, *frame[2:]) for *now, frame in zip(numbers, times, frames, strict=False)]
    data = b"".join(encode_frame(*frame) for frame in frames)
    came = received(*(data[at : at + cut] for at in range(0, len(data), cut)))
    assert len(came) == len(frames)
    for frame, (number, t, left, right, missed) in zip(came, frames, strict=True):
        assert (frame.number, frame.t, frame.missed, frame.timed) == (number, t, missed, True)
        for got, sent in ((frame.left, left), (frame.right, right)):
            assert (got is None) == (sent is None)
            assert got is None or sent is None or np.array_equal(got, sent)
        assert bool(frame.left_fault) == (left is None)


def header(**changes: object) -> bytes:
    whole = {"frame": 1, "t": 0.0, "left": [2, 2], "right": None, "missed": 0}
    return json.dumps({**whole, **changes}).encode() + b"\n"


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (header() + b"123", "ended within a frame"),
        (b'{"frame":1', "ended within a frame"),
        (b"hello\n", "sends no frames: 'hello'"),
        (b"[" * 3000 + b"\n", "sends no frames"),
        (b'{"frame":1,"t":1e999,"left":null,"right":null}\n', "sends no frames"),
        (b"5\n", "sends no frames"),
        (header(missed=-1), "sends no frames"),
        *[(header(frame=frame), "sends no frames") for frame in ("1", 10**300)],
        *[(header(t=t), "sends no frames") for t in (None, 10**400, -1e300)],
        *[
            (header(left=size), "sends no frames")
            for size in ([2, 2, 4], [0, 2], [2, MAX_SIDE + 1], [2, True])
        ],
    ],
)
def test_what_is_no_frame_ends_the_run(sent, words):
    refuses(words, received, sent)


def test_a_header_of_pictures_that_no_camera_takes():
    """Refused by its header: no byte of them is waited for, or has a place in memory."""
    for left, right in (([MAX_SIDE, MAX_SIDE], None), ([4096, 4096, 3], [4096, 4097])):
        refuses("sends no frames", received, header(left=left, right=right))
    most = header(left=[4096, 4096, 3], right=[4096, 4096])
    refuses("ended within a frame", received, most)
    said = "one line; the run ends"
    hold_row("a stream's header of pictures of over 64 MiB", said, "nothing")


def test_a_header_that_never_ends():
    refuses(f"a line of {MAX_HEADER} bytes", received, b" " * MAX_HEADER + header())
    hold_row("a stream's header that does not end", "one line; the run ends", "nothing")


@pytest.mark.parametrize(
    ("then", "words"),
    [
        ({"frame": 7}, "frame 7 of 5.0 s after frame 7 of 5.0 s"),
        ({"frame": 6, "t": 6.0}, "frame 6 of 6.0 s after frame 7"),
        ({"frame": 8, "t": 4.9}, "frame 8 of 4.9 s after frame 7"),
        ({"frame": -(2**53)}, "runs backwards"),
    ],
)
def test_a_stream_that_runs_backwards(then, words):
    first = header(frame=7, t=5.0, left=None)
    refuses(words, received, first, header(**{"t": 5.0, "left": None, **then}))
    said = "one line; the run ends"
    hold_row("a stream whose numbers or times run backwards", said, "nothing")


def test_a_stream_that_jumps_ahead():
    """How many frames are missing is what `missed` says."""
    ahead = header(frame=10**12, t=1e11, left=None), header(frame=2**53, t=1e11, left=None)
    assert [frame.missed for frame in received(header(left=None), *ahead)] == [0, 0, 0]


def test_nobody_there():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    text = f"stream:127.0.0.1:{port}"
    refuses(f"nobody sends frames at {text}", StreamSource, text, SYSTEM_CLOCK)


def test_stop_ends_a_wait():
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = StreamSource(f"stream:127.0.0.1:{server.getsockname()[1]}", SYSTEM_CLOCK)
        with closing(source), server.accept()[0] as connection:
            connection.sendall(header())  # its picture never comes
            threading.Timer(0.2, source.stop).start()
            assert list(source) == []
    said = "nothing, until it goes on or the run is stopped"
    hold_row("a stream that stalls within a frame", said, "nothing")


def test_options_that_would_do_nothing():
    asked = ("run", "--source", "stream:127.0.0.1:9", "--bundle", "x.tokt")
    refused("--rate is for recorded frames, not for a stream", *asked, "--rate", "5")
    refused("--trigger is for live cameras", *asked, "--trigger", "Line1")
    refused("--watchdog is not for a stream", *asked, "--watchdog")


@pytest.mark.process
def test_the_real_runtime_answers_each_frame_with_its_time(bundle_file):
    """In lock step: no frame is sent before the verdict on the one before has come."""
    rng = np.random.default_rng(1)
    with socket.create_server(("127.0.0.1", 0)) as server, bound_socket() as receiver:
        stream = f"stream:127.0.0.1:{server.getsockname()[1]}"
        udp = f"v2@127.0.0.1:{receiver.getsockname()[1]}"
        source = ("--source", stream, "--udp", udp)
        process = start_tokt("run", *source, "--bundle", bundle_file, "--policy", "texture")
        try:
            connection, _ = server.accept()
            for number in range(1, 4):
                picture = rng.integers(20, 60, (272, 360, 3)).astype(np.uint8)
                picture[:, 180:] += 30
                left = None if number == 2 else picture
                connection.sendall(encode_frame(number, 1e9 + number / 4, left, None))
                said = decode(receiver.recv(2000))
                assert (said["seq"], said["t"]) == (number, 1e9 + number / 4)
                assert (said["status"] == -1) == (number == 2)
            time.sleep(0.7)  # it waits, and says nothing by itself
            receiver.setblocking(False)
            with pytest.raises(BlockingIOError):
                receiver.recv(2000)
            process.send_signal(signal.SIGTERM)
            assert process.wait(MAX_S) == 0
            connection.close()
        finally:
            process.kill()
            process.communicate()
