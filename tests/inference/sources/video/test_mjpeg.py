"""JPEGs over HTTP: streams as servers send them, single pictures, and damage that is no picture."""

import random
import socket
import threading
import time
from base64 import b64encode
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tests.waiting import until
from tokt.features.frames.image_file import decode_image
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.reason import Reason
from tokt.inference.sources.video.mjpeg import Parts, jpeg_decoder, read_mjpeg
from tokt.inference.sources.video.newest import StreamLostError

from .pictures import jpeg, number_of
from .reading import reading, words_of
from .senders import mjpeg

PICTURES = [jpeg(number) for number in range(4)]


def reads(url):
    return reading(read_mjpeg, url)


@contextmanager
def server(answer):
    """A server whose answers a function writes; yields its address, which has no path."""
    ended = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            answer(self)

        def starts(self, boundary="b"):
            """Begin a stream."""
            self.answers(200, "Content-Type", f"multipart/x-mixed-replace; boundary={boundary}")

        def answers(self, status, header, value):
            self.send_response(status)
            self.send_header(header, value)
            self.end_headers()

        def sends(self, *pictures, head=b""):
            told = ((head + b"Content-Length: %d\r\n\r\n" % len(p), p) for p in pictures)
            self.wfile.write(b"".join(b"--b\r\n" + head + p + b"\r\n" for head, p in told))
            self.wfile.flush()

        def repeats(self, picture, head=b""):
            """Send a picture again and again, until the client goes."""
            with suppress(OSError):
                while not ended.wait(0.02):
                    self.sends(picture, head=head)

        def shows(self, picture, head=b""):
            """Send a stream of one picture."""
            self.starts()
            self.repeats(picture, head)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as served:
        served.daemon_threads, served.block_on_close = True, False
        thread = threading.Thread(target=served.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"127.0.0.1:{served.server_address[1]}"
        finally:
            ended.set()
            served.shutdown()
            thread.join()


def parts_of(data, boundary, step=7):
    parts = Parts(boundary)
    pieces = (data[at : at + step] for at in range(0, len(data), step))
    return [part for piece in pieces for part in parts.feed(piece)]


HEAD = b"Content-Type: image/jpeg\r\nX-Timestamp: 1700000000.25\r\n"


@pytest.mark.parametrize("told", ["frame", "--frame"])
@pytest.mark.parametrize("sent", [b"--frame", b"----frame"])
@pytest.mark.parametrize("lengths", [False, True])
@pytest.mark.parametrize("line", [b"\r\n", b"\n"])
def test_servers_write_boundaries_in_every_way(told, sent, lengths, line):
    data = b"some words" + line
    for picture in PICTURES:
        length = b"Content-length: %d\r\n" % len(picture) if lengths else b""
        data += sent + line + (HEAD + length).replace(b"\r\n", line) + line + picture + line
    for step in (1, 1000, len(data)):
        parts = parts_of(data + sent + line, told, step)
        assert [body.rstrip(b"-").removesuffix(line) for _, body in parts] == PICTURES
        assert {taken_s for taken_s, _ in parts} == {1700000000.25}


def test_a_part_without_headers_and_a_wrong_length_cost_no_other_part():
    short = b"--b\r\nContent-Length: 90\r\n\r\n" + PICTURES[0] + b"\r\n"
    data = (
        b"--b\r\n\r\n" + PICTURES[1] + b"\r\n" + short + b"--b\r\n\r\n" + PICTURES[2] + b"\r\n--b"
    )
    bodies = [body.removesuffix(b"\r\n") for _, body in parts_of(data + b"--\r\n", "b", 500)]
    assert bodies == [PICTURES[1], PICTURES[0][:90], PICTURES[2]]


@settings(max_examples=scaled(200), deadline=None)
@given(st.integers(0, 2**32))
def test_no_bytes_make_the_parser_fail(seed):
    rng = random.Random(seed)
    words = [b"--b\r\n", b"\r\n\r\n", b"Content-Length: ", b"5", b"-1", b"9" * 30, b"\xff", b"\n"]
    words += [b"--b", b"\0", PICTURES[0], b"x: y\r\n", "²".encode()]
    data = b"".join(rng.choice(words) for _ in range(rng.randrange(40)))
    assert all(isinstance(body, bytes) for _, body in parts_of(data, "b", rng.randrange(1, 99)))


@pytest.mark.parametrize(
    "data", [b"-" * (1 << 20), b"--b\n" * 50_000, b"--b\n" + b"x:y\n" * 250_000]
)
def test_no_bytes_take_long(data):
    """Searched again from each of its bytes, it would take a quarter of an hour."""
    parts_of(data, "b", 1 << 18)


def test_a_picture_without_end_is_told():
    parts = Parts("b")
    parts.feed(b"--b\r\n\r\n")
    with pytest.raises(StreamLostError, match="no end"):
        for _ in range(40):
            parts.feed(bytes(1 << 20))


def scan_of(data):
    """Where a JPEG's entropy-coded data begin and end."""
    return data.index(b"\xff\xda") + 14, len(data) - 2


@pytest.mark.parametrize("kind", ["lost", "zeros", "twice", "end"])
def test_a_damaged_jpeg_is_no_picture(kind):
    """Of 3,000 pictures with zeros in them 7 are not told: what follows happens to fit."""
    taken = 0
    for seed in range(scaled(100)):
        rng = random.Random(seed)
        data = jpeg(rng.randrange(9), restarts=rng.choice((0, 4)))
        start, end = scan_of(data)
        at, size = rng.randrange(start, end - 2100), rng.choice((300, 512, 1400, 2000))
        inner = {"lost": b"", "zeros": bytes(size), "twice": data[at : at + size] * 2}
        changed = data[:at] + inner.get(kind, b"") + data[at + size :]
        with jpeg_decoder() as decode:
            picture, fault = decode(data[:at] if kind == "end" else changed)
            whole, no_fault = decode(data)
        taken += picture is not None
        assert (fault.reason is Reason.INCOMPLETE) == (picture is None)
        assert np.array_equal(whole, decode_image(data, ""))
        assert not no_fault
    assert taken <= (2 if kind == "zeros" else 0)


def test_zeros_in_front_of_the_end_and_after_it_are_padding():
    for number in range(40):
        data = jpeg(number, (96, 96))
        with jpeg_decoder() as decode:
            picture, fault = decode(data[:-2] + bytes(5) + data[-2:] + bytes(300))
        assert not fault
        assert np.array_equal(picture, decode_image(data, ""))


def test_a_camera_is_read(tmp_path):
    with mjpeg(tmp_path) as camera, reads(camera.url) as (newest, _):
        numbers = [number_of(newest.next().picture) for _ in range(6)]
    assert numbers == sorted(set(numbers))


@pytest.mark.parametrize("broken", [PICTURES[1][: len(PICTURES[1]) // 2], b"no picture at all"])
def test_a_part_that_is_no_whole_picture_is_told(broken):
    def answer(handler):
        handler.starts()
        with suppress(OSError):
            while not time.sleep(0.02):
                handler.sends(PICTURES[0])
                time.sleep(0.02)
                handler.sends(broken)

    with server(answer) as at, reads(f"http://{at}/") as (newest, _):
        seen = [newest.next() for _ in range(6)]
    assert {number_of(one.picture) for one in seen if one.picture is not None} == {0}
    assert {one.fault.reason for one in seen if one.picture is None} == {Reason.INCOMPLETE}


@pytest.mark.parametrize(("hangs", "words"), [(True, "sends no more"), (False, "ended the stream")])
def test_a_stream_that_hangs_or_ends_within_a_picture_is_lost(hangs, words):
    def answer(handler):
        handler.starts()
        handler.wfile.write(b"--b\r\n\r\n" + PICTURES[0][:100])
        if hangs:
            goes.wait()

    goes = threading.Event()
    with server(answer) as at:
        assert words in words_of(read_mjpeg, f"http://{at}/")
        goes.set()


def test_what_was_held_up_gives_way_to_the_newest():
    def answer(handler):
        handler.starts()
        handler.sends(*(each for each in PICTURES for _ in range(5)))
        goes.wait()

    goes, taken = threading.Event(), []
    with server(answer) as at, reads(f"http://{at}/") as (newest, _):

        def is_last():
            taken.append(newest.next().picture)
            return taken[-1] is not None and number_of(taken[-1]) == 3

        until(is_last)
        assert len(taken) < 15
        goes.set()


def test_times_that_a_server_tells_are_taken_over():
    """Also of when a picture came that was held up on its way."""

    def answer(handler):
        handler.starts()
        handler.sends(PICTURES[0], head=b"X-Timestamp: %.3f\r\n" % now)
        first.wait()
        time.sleep(0.3)
        handler.repeats(PICTURES[1], b"X-Timestamp: %.3f\r\n" % (now + 0.1))

    first, now = threading.Event(), SYSTEM_CLOCK.time()
    with server(answer) as at, reads(f"http://{at}/") as (newest, _):
        one = newest.next()
        first.set()
        other = newest.next()
    assert one.captured_t == one.taken_s == pytest.approx(now, abs=0.001)
    assert other.arrived - one.arrived == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("stamp", [b"yesterday", b"-5", b"nan", b"1e300", b""])
def test_times_that_make_no_sense_are_none(stamp):
    shows = lambda handler: handler.shows(PICTURES[0], b"X-Timestamp: " + stamp + b"\r\n")  # noqa: E731
    with server(shows) as at, reads(f"http://{at}/") as (newest, _):
        one = newest.next()
        assert one.captured_t is None
        assert one.taken_s is None


@pytest.mark.parametrize(
    ("asks", "wanted"),
    [
        ('Basic realm="camera"', "Basic " + b64encode(b"me:it's").decode()),
        ('Digest realm="camera", nonce="7", qop="auth", algorithm=MD5', 'Digest username="me"'),
    ],
)
def test_a_user_and_a_password_are_sent_where_they_are_asked_for(asks, wanted):
    def answer(handler):
        if (handler.headers["Authorization"] or "").startswith(wanted):
            handler.shows(PICTURES[2])
        else:
            handler.answers(401, "WWW-Authenticate", asks)

    with server(answer) as at:
        for other in ("", "you:wrong@"):
            words = words_of(read_mjpeg, f"http://{other}{at}/")
            assert "wants a user and a password" in words
        with reads(f"http://me:it's@{at}/") as (newest, _):
            assert newest.next().picture is not None


@pytest.mark.parametrize("to", ["file:///etc/passwd", "ftp://127.0.0.1/x", "gopher://a"])
def test_a_redirect_leads_nowhere_but_to_http(to):
    with server(lambda handler: handler.answers(302, "Location", to)) as at:
        words = words_of(read_mjpeg, f"http://{at}/")
    assert "302" in words or "unknown url type" in words


def test_a_redirect_is_followed():
    def answer(handler):
        if handler.path == "/":
            handler.answers(302, "Location", "/video")
        else:
            handler.shows(PICTURES[2])

    with server(answer) as at, reads(f"http://{at}/") as (newest, _):
        assert number_of(newest.next().picture) == 2


def test_nobody_who_answers_and_answers_that_are_none_are_told():
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        assert "refused" in words_of(read_mjpeg, f"http://127.0.0.1:{bound.getsockname()[1]}/")
    with server(lambda handler: handler.wfile.write(b"no HTTP\r\n\r\n")) as at:
        assert "no sense" in words_of(read_mjpeg, f"http://{at}/")
    with server(lambda handler: handler.send_error(404)) as at:
        assert "404" in words_of(read_mjpeg, f"http://{at}/")
    with server(lambda handler: handler.answers(200, "Content-Type", "text/html")) as at:
        assert "text/html, no stream" in words_of(read_mjpeg, f"http://{at}/")
    with server(lambda handler: handler.starts("")) as at:
        assert "no boundary" in words_of(read_mjpeg, f"http://{at}/")
