"""JPEGs over HTTP: streams as servers send them, single pictures, and damage that is no picture."""

import random
import socket
import threading
from base64 import b64encode
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tests.waiting import until
from tokt.features.frames.image_file import decode_image
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.reason import Reason
from tokt.inference.sources.video.address import VideoAddress
from tokt.inference.sources.video.mjpeg import Parts, jpeg_decoder, read_mjpeg
from tokt.inference.sources.video.newest import NewestReading, StreamLostError

from .pictures import bgr, number_of
from .senders import mjpeg


def jpeg(number, size=(320, 240), restarts=0):
    flags = [cv2.IMWRITE_JPEG_QUALITY, 80, cv2.IMWRITE_JPEG_RST_INTERVAL, restarts]
    return cv2.imencode(".jpg", bgr(number, size), flags)[1].tobytes()


PICTURES = [jpeg(number) for number in range(4)]


@contextmanager
def reading(url):
    """A reader of an address on a thread: what it puts, and why it ended."""
    newest, words = NewestReading(), []
    newest.alive = lambda: None  # the test's process is not to be ended

    def work():
        try:
            read_mjpeg(VideoAddress.parse(url), newest)
        except StreamLostError as error:
            words.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield newest, words
    finally:
        newest.stopped.set()
        thread.join()


def next_of(newest):
    return until(lambda: newest.take(0.1))[1]


def words_of(url):
    """Why an address cannot be read."""
    with reading(url) as (_, words):
        until(lambda: words)
    return words[0]


@contextmanager
def server(answer):
    """A server whose answers a function writes; yields its address, which has no path."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            answer(self)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as served:
        served.daemon_threads, served.block_on_close = True, False
        thread = threading.Thread(target=served.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"127.0.0.1:{served.server_address[1]}"
        finally:
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


def test_a_stream_is_read_and_its_faults_are_no_pictures(tmp_path):
    with mjpeg(tmp_path) as camera:
        for fault in ("", "no%20length", "cut", "garbage"):
            with reading(f"{camera.url}?fault={fault}") as (newest, _):
                seen = [next_of(newest) for _ in range(6)]
            numbers = [number_of(one.picture) for one in seen if one.picture is not None]
            assert None not in numbers
            assert numbers == sorted(numbers)
            reasons = {one.fault.reason for one in seen if one.picture is None}
            assert reasons == ({Reason.INCOMPLETE} if fault in ("cut", "garbage") else set())
        assert "sends no more" in words_of(f"{camera.url}?fault=hangs")
        assert "ended the stream" in words_of(f"{camera.url}?fault=ends")
        assert "text/html, no stream" in words_of(f"{camera.url}?fault=page")
        assert "404" in words_of(f"{camera.url}?fault=missing")


def multipart(handler, boundary="b"):
    handler.send_response(200)
    handler.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={boundary}")
    handler.end_headers()


def send_part(handler, picture, head=b""):
    told = b"Content-Length: %d\r\n" % len(picture)
    handler.wfile.write(b"--b\r\n" + head + told + b"\r\n" + picture + b"\r\n")
    handler.wfile.flush()


def test_what_was_held_up_gives_way_to_the_newest():
    def answer(handler):
        multipart(handler)
        handler.wfile.write(
            b"".join(
                b"--b\r\nContent-Length: %d\r\n\r\n" % len(p) + p
                for p in PICTURES
                for _ in range(5)
            )
        )
        handler.wfile.flush()
        goes.wait()

    goes = threading.Event()
    with server(answer) as at, reading(f"http://{at}/") as (newest, _):
        until(lambda: (got := next_of(newest).picture) is not None and number_of(got) == 3)
        assert newest._count < 15
        goes.set()


def test_times_that_a_server_tells_are_taken_over():
    def answer(handler):
        multipart(handler)
        now = SYSTEM_CLOCK.time()
        send_part(handler, PICTURES[0], b"X-Timestamp: %.3f\r\n" % now)
        first.wait()
        send_part(handler, PICTURES[1], b"X-Timestamp: %.3f\r\n" % (now - 0.6))
        stop.wait()

    first, stop = threading.Event(), threading.Event()
    with server(answer) as at, reading(f"http://{at}/") as (newest, _):
        one = next_of(newest)
        assert one.captured_t == one.taken_s
        assert abs(one.captured_t - SYSTEM_CLOCK.time()) < 120
        newest._taken_s = 0.0  # it came in the wrong order, which else leaves it out
        first.set()
        late = next_of(newest)
        assert one.arrived - late.arrived == pytest.approx(0.6, abs=0.1)
        stop.set()


@pytest.mark.parametrize("stamp", [b"yesterday", b"-5", b"nan", b"1e300", b""])
def test_times_that_make_no_sense_are_none(stamp):
    def answer(handler):
        multipart(handler)
        send_part(handler, PICTURES[0], b"X-Timestamp: " + stamp + b"\r\n")
        stop.wait()

    stop = threading.Event()
    with server(answer) as at, reading(f"http://{at}/") as (newest, _):
        one = next_of(newest)
        assert one.captured_t is None
        assert one.taken_s is None
        stop.set()


def test_a_user_and_a_password_are_sent_where_they_are_asked_for():
    def answer(handler):
        if handler.headers["Authorization"] == "Basic " + b64encode(b"me:it's").decode():
            multipart(handler)
            send_part(handler, PICTURES[2])
            stop.wait()
        else:
            handler.send_response(401)
            handler.send_header("WWW-Authenticate", 'Basic realm="camera"')
            handler.end_headers()

    stop = threading.Event()
    with server(answer) as at:
        assert "wants a user and a password" in words_of(f"http://{at}/")
        assert "wants a user and a password" in words_of(f"http://me:wrong@{at}/")
        with reading(f"http://me:it's@{at}/") as (newest, _):
            assert next_of(newest).picture is not None
            stop.set()


def test_digest_is_answered():
    def answer(handler):
        given = handler.headers["Authorization"] or ""
        if given.startswith("Digest") and 'username="me"' in given:
            multipart(handler)
            send_part(handler, PICTURES[2])
            stop.wait()
        else:
            handler.send_response(401)
            told = 'Digest realm="camera", nonce="7", qop="auth", algorithm=MD5'
            handler.send_header("WWW-Authenticate", told)
            handler.end_headers()

    stop = threading.Event()
    with server(answer) as at, reading(f"http://me:p@{at}/") as (newest, _):
        assert next_of(newest).picture is not None
        stop.set()


@pytest.mark.parametrize("to", ["file:///etc/passwd", "ftp://127.0.0.1/x", "gopher://a"])
def test_a_redirect_leads_nowhere_but_to_http(to):
    def answer(handler):
        handler.send_response(302)
        handler.send_header("Location", to)
        handler.end_headers()

    with server(answer) as at:
        words = words_of(f"http://{at}/")
    assert "302" in words or "unknown url type" in words


def test_a_redirect_is_followed():
    def answer(handler):
        if handler.path == "/":
            handler.send_response(302)
            handler.send_header("Location", "/video")
            handler.end_headers()
        else:
            multipart(handler)
            send_part(handler, PICTURES[2])
            stop.wait()

    stop = threading.Event()
    with server(answer) as at, reading(f"http://{at}/") as (newest, _):
        assert number_of(next_of(newest).picture) == 2
        stop.set()


def test_nobody_who_answers_and_answers_that_are_none_are_told():
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        assert "refused" in words_of(f"http://127.0.0.1:{bound.getsockname()[1]}/")
    with server(lambda handler: handler.wfile.write(b"no HTTP\r\n\r\n")) as at:
        assert "no sense" in words_of(f"http://{at}/")
    with server(lambda handler: multipart(handler, "")) as at:
        assert "no boundary" in words_of(f"http://{at}/")
