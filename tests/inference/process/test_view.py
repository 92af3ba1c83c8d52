"""The live view over real sockets: who may ask, clients that misbehave, a process that dies."""

import json
import multiprocessing
import os
import re
import signal
import socket
import threading
import time
from contextlib import suppress

import numpy as np
import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refused, refuses
from tests.inference.live import start_tokt
from tests.inference.test_faults import hold_row
from tests.inference.view_client import STREAM, ask, decoded, stream_parts, viewed
from tests.tiers import scaled
from tests.waiting import MAX_S, until
from tokt.inference.config import Limits
from tokt.inference.outputs import view as view_module
from tokt.inference.outputs.view import LiveView, listening, view_url
from tokt.inference.outputs.view_server import MAX_CLIENTS
from tokt.inference.outputs.view_video import new_video

REFUSED = "refused with code 403; no version of Python is told", "nothing"
RED, GREEN = (30, 30, 200), (60, 110, 20)


@pytest.fixture(scope="module")
def view():
    """One that all tests here look at which do it no harm."""
    with viewed() as made:
        yield made


@pytest.fixture(scope="module")
def guarded():
    """One with a token, which is asked for."""
    with viewed(token="a b/c") as made:
        yield made


def is_banner(picture, colour):
    return np.abs(decoded(picture)[4, 60].astype(int) - colour).max() < 12


def test_the_picture_and_its_words_are_of_one_moment(view):
    for word, patches, colour in (("OBSTACLE", [(4, 2)], RED), ("CLEAR", [], GREEN)):
        words, picture = view.until_shown(word, patches)
        assert np.abs(picture[4, 60].astype(int) - colour).max() < 12
        assert list(words) == ["number", "word", "why", "age_s", "facts", "frame", "rows"]
        assert words["facts"]["model"] == "noise/1" and 0 <= words["age_s"] < MAX_S
        assert ("steer" in words["facts"]) == (word == "OBSTACLE")
    if os.name == "posix":
        assert psutil.Process(view.child).nice() > psutil.Process().nice()
    assert view.until_shown("UNKNOWN", left=np.zeros((271, 360), np.uint8))[0]["why"].startswith(
        "dark"
    )


def test_an_answer_is_another_picture_than_the_last(view):
    words, _ = view.until_shown("CLEAR")
    status, headers, _ = view.get(f"/picture?after={words['number']}")
    assert status == 200 and json.loads(headers["X-Tokt"])["number"] > words["number"]


def test_what_is_asked_wrongly_is_refused(view):
    here = f"127.0.0.1:{view.port}"
    view.until_shown("CLEAR")
    for status, path, headers in (
        (404, "/other", {}),
        (404, "/../../etc/passwd", {}),
        (403, "/", {"Host": f"evil.example:{view.port}"}),
        (403, "/picture", {"Host": f"evil.example:{view.port}"}),
        (403, "/stream.mjpg", {"Host": "127.0.0.1"}),
        (403, "/", {"Host": ""}),
        (200, "/", {"Host": f"LocalHost:{view.port}"}),
        (200, "/picture?after=99999999999999999999999", {"Host": here}),
        (200, "/picture?after=%00&after=x&token=x", {"Host": here}),
    ):
        answered, about, _ = view.get(path, **headers)
        assert (answered, about["Server"].strip()) == (status, "tokt"), (path, headers)
    with view.connect(b"GET http://[/ HTTP/1.1\r\nHost: %b\r\n\r\n" % here.encode()) as opened:
        assert opened.recv(4096).startswith(b"HTTP/1.1 404")
    hold_row("the live view without a token is asked for by another host name", *REFUSED)
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "CONNECT"):
        assert view.get("/", method)[0] == (403 if method == "POST" else 501)
    for path in ("/", "/picture", "/stream.mjpg"):
        status, headers, body = view.get(path, "HEAD")
        assert (status, body) == (200, b"") and headers["Content-Type"]


@pytest.mark.parametrize("name", ["view", "guarded"])
def test_only_its_own_page_names_an_object(name, request):
    """Another site can send a POST, with a body that looks like one of ours."""
    view = request.getfixturevalue(name)
    here, asks = f"127.0.0.1:{view.port}", "token=a%20b%2Fc&" if view.token else ""
    own = {"Host": here, "Origin": f"http://{here}"}
    path, evil = f"/object?{asks}box=1,0.4,0.1,0.2,0.3", f"evil.example:{view.port}"
    view.see([(4, 2)])
    for status, asked, headers in (
        (403, path, {"Host": here}),
        (403, path, {"Host": here, "Origin": "null"}),
        (403, path, {"Host": here, "Origin": f"http://{evil}"}),
        (403, path, {"Host": here, "Origin": f"http://localhost:{view.port}"}),
        (404, f"/?{asks}", own),
        *((400, f"/object?{asks}box={box}", own) for box in ("", "1", "1,2,3,4", "x,0,0,1,1")),
        *((400, f"/object?{asks}box={box}", own) for box in ("inf,0,0,1,1", "nan,0,0,1,1")),
    ):
        assert view.get(asked, "POST", **headers)[0] == status, (asked, headers)
    if view.token:
        assert view.get(path.replace("token=a", "token=b"), "POST", **own)[0] == 401
    else:
        assert view.get(path, "POST", Host=evil, Origin=f"http://{evil}")[0] == 403
    hidden = f"POST {path} HTTP/1.1\r\nHost: {here}\r\nOrigin: http://{here}\r\n\r\n"
    outer = f"POST {path} HTTP/1.1\r\nHost: {here}\r\nOrigin: http://{evil}\r\n"
    with view.connect(f"{outer}Content-Length: {len(hidden)}\r\n\r\n{hidden}".encode()) as opened:
        opened.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: _received(opened), b""))
    assert answer.count(b"HTTP/1.1") == 1 and b" 403 " in answer
    for _ in range(3):
        view.until_shown("OBSTACLE", [(4, 2)])
    assert view.policy.tracker is None and view.events == []
    assert view.get(path.replace("box=1,", "box=999,"), "POST", **own)[0] == 200
    until(lambda: view.see([(4, 2)]) and view.events)
    refused_box = view.events.pop()
    assert refused_box.name == "object_refused" and "frame 999 is not kept" in refused_box.words
    assert view.events == []


def test_any_page_may_frame_it_and_its_script_alone_runs(view):
    _, headers, page = view.get("/")
    policy = headers["Content-Security-Policy"]
    assert "X-Frame-Options" not in headers and "frame-ancestors" not in policy
    (nonce,) = set(re.findall(r"'nonce-([\w-]+)'", policy))
    assert page.decode().count(f'nonce="{nonce}"') == 2 and "unsafe" not in policy
    assert nonce not in view.get("/")[1]["Content-Security-Policy"]
    assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")


@settings(max_examples=scaled(60))
@given(
    st.one_of(
        st.binary(max_size=2000),
        st.binary(max_size=200).map(lambda raw: b"GET /" + raw + b" HTTP/1.1\r\n\r\n"),
        st.binary(max_size=200).map(lambda raw: b"GET / HTTP/1.1\r\nHost: " + raw + b"\r\n\r\n"),
        st.text(max_size=99).map(
            lambda text: f"GET /picture?after={text} HTTP/1.0\r\n\r\n".encode()
        ),
    )
)
def test_any_bytes_are_a_request_that_is_refused(view, said):
    """What is no request for the page gets an error or nothing, and the next client its page."""
    with view.connect(said) as opened:
        opened.shutdown(socket.SHUT_WR)
        answer = b"".join(iter(lambda: _received(opened), b""))
    assert re.match(rb"HTTP/1\.\d (4|5)\d\d |<!DOCTYPE|$", answer), answer
    assert view.get("/", "HEAD")[0] == 200


def _received(opened):
    try:
        return opened.recv(65_536)
    except ConnectionError:
        return b""


def test_twenty_clients_some_of_which_never_read_all_see_the_newest(view):
    stalled = [view.connect(STREAM % view.port) for _ in range(4)]
    slow = [view.connect(b"GET / HT") for _ in range(4)]
    seen = {}

    def look(number):
        def note(jpeg):
            seen[number] = [colour for colour in (RED, GREEN) if is_banner(jpeg, colour)]

        with suppress(OSError):  # the view is closed
            while True:
                opened = view.connect(STREAM % view.port)
                with suppress(AssertionError):  # hung up on, as this machine was too busy to read
                    stream_parts(opened, note)

    for number in range(20):
        threading.Thread(target=look, args=(number,), daemon=True).start()
    for patches, colour in (([(4, 2)], RED), ([], GREEN)):
        until(
            lambda patches=patches, colour=colour: (
                view.see(patches) and [*seen.values()] == 20 * [[colour]]
            )
        )
    for opened in stalled:  # each is hung up on, as its pictures do not fit any more
        opened.settimeout(MAX_S)
    assert view.events == []
    for opened in (*stalled, *slow):
        opened.close()


def test_who_asks_a_letter_at_a_time_is_hung_up_on(view):
    with view.connect(b"GET / HTTP/1.1\r\n") as opened:
        opened.settimeout(0.2)

        def cut():
            try:
                opened.sendall(b"X")
                return not opened.recv(1)
            except TimeoutError:
                return False
            except ConnectionError:
                return True

        until(cut)


def test_a_request_that_is_too_long_is_no_request(view):
    """Else a few clients' headers would fill the vehicle's memory."""
    view.until_shown("CLEAR")
    many = b"".join(b"X-%d: %b\r\n" % (number, 60_000 * b"x") for number in range(90))
    asks = b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n" % view.port
    for more, answered in ((many, False), (b"X: " + 9000 * b"x" + b"\r\n", True)):
        with view.connect() as opened:
            with suppress(ConnectionError):
                opened.sendall(asks + more + b"\r\n")
            assert _received(opened).startswith(b"HTTP/1.1 200") == answered


@pytest.mark.parametrize("asks", [b"G", b"", b"GET / HTTP/1.1\r\nHost: x\r\n"])
@pytest.mark.parametrize("hosts", [1, 59], ids=["one", "many"])
@pytest.mark.parametrize("first", [1, 2], ids=["the viewer's", "another"])
def test_a_crowd_without_the_token_keeps_nobody_out(guarded, first, hosts, asks):
    """It asks a part and waits: its first connections are hung up on for its last ones."""
    crowd = []
    for number in range(2 * MAX_CLIENTS):
        opened = socket.socket()
        guarded.clients.callback(opened.close)
        opened.settimeout(MAX_S)
        try:
            opened.bind((f"127.0.0.{first + number % hosts}", 0))
        except OSError:
            pytest.skip("this computer's loopback has one address")
        opened.connect(("127.0.0.1", guarded.port))
        opened.sendall(asks)
        crowd.append(opened)
    for _ in range(5):
        assert guarded.get("/?token=a+b%2Fc")[0] == 200
    assert _received(crowd[0]) == b""
    for opened in crowd:
        opened.close()
    fault = "connections to the live view without its token, more than there is room for"
    hold_row(fault, "as without it; who has the token gets in", "nothing")


@pytest.mark.parametrize("asks", [STREAM, b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n"])
def test_of_more_clients_than_there_is_room_for_the_slowest_are_hung_up_on(view, asks):
    view.until_shown("CLEAR")
    many = [view.connect(asks % view.port) for _ in range(2 * MAX_CLIENTS)]
    for _ in range(5):
        assert view.get("/")[0] == 200
    until(lambda: view.see() and _is_closed(many[0]))
    for opened in many:
        opened.close()
    fault = "clients of the live view that never read, more than there is room for"
    hold_row(fault, "as without it; the slowest are hung up on", "nothing")


def _is_closed(opened):
    return not _received(opened)


def is_covered(picture):
    """Whether a word stands across the picture."""
    return (picture[50 + (len(picture) - 188) // 2 - 72] < 25).all()


def test_a_stream_goes_on_without_frames_and_its_last_picture_says_ended():
    with viewed(Limits(0.5, MAX_S)) as view:
        view.until_shown("CLEAR")
        time.sleep(2.3)  # nobody looks, and nothing is drawn
        words, _ = _says(view, "OLD")
        assert words["age_s"] > 2.3  # what is true now, and not what was last drawn
        with view.connect(STREAM % view.port) as opened:
            until(lambda: view.see() and stream_parts(opened, lambda jpeg: is_banner(jpeg, GREEN)))
            # Not one frame more: it is drawn anew all the same, and is old.
            until(lambda: _says(view, "OLD"))
            drawn = iter(range(4))
            stream_parts(opened, lambda jpeg: next(drawn) == 3)
            view.view.close()
            data = b"".join(iter(lambda: opened.recv(65_536), b""))
    assert data.endswith(b"\r\n--frame--\r\n")
    assert is_covered(decoded(data[data.rindex(b"\xff\xd8\xff") :]))


def _says(view, word):
    status, headers, body = view.get("/picture")
    words = json.loads(headers["X-Tokt"]) if status == 200 else {"word": status}
    return (words, body) if words["word"] == word else None


@pytest.mark.parametrize(
    ("hows", "why"),
    [([signal.SIGKILL, signal.SIGSTOP], "exit code -9"), ([signal.SIGSTOP], "did not answer")],
)
def test_a_process_that_dies_or_hangs_is_told_once_and_started_again(hows, why, monkeypatch):
    monkeypatch.setattr(view_module, "ANSWER_S", 1.0)
    monkeypatch.setattr(view_module, "_PAUSE_S", 0.05)
    with viewed() as view:
        for how in hows:
            view.until_shown("CLEAR")
            child, spent = view.child, []
            view.signal(how)

            def goes_on(child=child, spent=spent):
                """Whatever the view does, the loop goes on."""
                before = time.perf_counter()
                assert view.see().verdict.status == 0
                spent.append(time.perf_counter() - before)
                return view.view._process.pid != child

            until(goes_on)
            assert np.median(spent) < 0.1
        view.until_shown("OBSTACLE", [(4, 2)])
        (event,) = view.events
        assert event.name == "view_lost" and why in event.words


def test_a_run_that_ends_while_the_view_is_gone_leaves_no_empty_video(tmp_path):
    pytest.importorskip("av")
    with viewed(record=tmp_path / "out.mp4", served=False) as view:
        view.signal(signal.SIGKILL)
        until(lambda: view.see() and view.events)
    assert [each.name for each in tmp_path.iterdir()] == ["out.mp4.part"]


def test_one_that_cannot_be_started_is_told(monkeypatch):
    def refuse(process):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(multiprocessing.get_context("spawn").Process, "start", refuse)
    with viewed() as view:
        until(lambda: view.events)
        assert "cannot be started: Resource temporarily" in view.events[0].words


def test_on_another_address_a_token_is_asked_for(guarded):
    assert guarded.url == f"http://127.0.0.1:{guarded.port}/?token=a%20b%2Fc"
    for query in ("", "?token=", "?token=a", "?token=a+b%2Fd", "?token=%ff", "?token=%C5%A1"):
        for path in ("/", "/picture", "/stream.mjpg", "/other"):
            assert guarded.get(path + query)[0] == 401
    shown = until(lambda: guarded.see() and guarded.get("/picture?token=a+b%2Fc"))
    assert shown[0] == 200
    # A vehicle's name may be anything: who has the token is no rebound page.
    assert guarded.get("/?token=a%20b%2Fc", Host="blueos.local")[0] == 200


def frames_of(path):
    import av

    with av.open(str(path)) as container:
        return [
            (float(frame.time), frame.to_ndarray(format="bgr24"))
            for frame in container.decode(video=0)
        ]


def test_a_video_has_the_run_s_own_times_and_overwrites_nothing(tmp_path):
    pytest.importorskip("av")
    path = tmp_path / "out.mp4"
    path.write_bytes(b"another's")
    with viewed(record=path, served=False) as view:
        part = tmp_path / "out-2.mp4.part"
        assert part.exists()
        # Two frames that are 10 s apart by their arrival, though shown one after the other.
        until(lambda: view.see([(4, 2)], age_s=10) and part.stat().st_size)
        began = time.monotonic()
        until(lambda: view.see() and time.monotonic() - began > 1)
    assert path.read_bytes() == b"another's" and not part.exists()
    frames = frames_of(tmp_path / "out-2.mp4")
    times = [at for at, _ in frames]
    assert times[0] == 0 and times == sorted(set(times))
    assert 10 < times[-1] < 10 + MAX_S
    assert np.abs(frames[0][1][4, 60].astype(int) - RED).max() < 25
    assert is_covered(frames[-1][1])  # ENDED


def test_a_killed_process_s_video_can_be_read(tmp_path, monkeypatch):
    pytest.importorskip("av")
    monkeypatch.setattr(view_module, "_PAUSE_S", 0.05)
    path = tmp_path / "out.mp4"
    with viewed(record=path, served=False) as view:
        part = tmp_path / "out.mp4.part"
        until(lambda: view.see() and part.stat().st_size > 8_000)
        view.signal(signal.SIGKILL)
        until(lambda: view.see() and (tmp_path / "out-2.mp4.part").exists())
        assert len(frames_of(part)) >= 3
        until(lambda: view.see() and (tmp_path / "out-2.mp4.part").stat().st_size > 1000)
    assert frames_of(tmp_path / "out-2.mp4") and part.exists() and not path.exists()


def test_a_video_that_cannot_be_written_is_told_and_the_view_goes_on(tmp_path, monkeypatch):
    pytest.importorskip("av")
    path = tmp_path / "out.mp4"
    with viewed(record=path) as view:
        part = tmp_path / "out.mp4.part"
        part.unlink()
        part.symlink_to("/dev/full")
        until(lambda: view.see() and view.events)
        view.until_shown("CLEAR")
        (event,) = view.events
        assert event.name == "video_failed" and "No space left" in event.words
    hold_row("the live view's video: its disk is full", "as without it", "event `video_failed`")


def test_what_a_user_can_get_wrong(tmp_path, monkeypatch, make_mission, bundle_file):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refuses(f"the view cannot be served on 127.0.0.1:{port}", listening, "127.0.0.1", port)
    refuses("is a port", listening, "127.0.0.1", 70_000)
    refuses("cannot be found", listening, "no such host", 0)
    refuses("out.mp4 cannot be written: No such file", new_video, tmp_path / "none" / "out.mp4")
    made = (None, None, tmp_path / "out.avi", 0.5, None, None)
    refuses("writes an .mp4 file, not 'out.avi'", LiveView, *made)
    monkeypatch.setattr(view_module, "find_spec", lambda name: None)
    made = (None, None, tmp_path / "out.mp4", 0.5, None, None)
    refuses(r"the extra 'video'", LiveView, *made)
    asked = ("run", "--source", make_mission([[]]), "--bundle", bundle_file)
    refused("--view-host is of no use without --view", *asked, "--view-host", "0.0.0.0")
    refused("--view-record is for live cameras, or", *asked, "--view-record", tmp_path / "o.mp4")


def test_a_wildcard_s_url_has_a_name(monkeypatch):
    monkeypatch.setattr(socket, "gethostname", lambda: "rov")
    assert view_url("0.0.0.0", 8200, "t") == "http://rov:8200/?token=t"
    assert view_url("::1", 8200, None) == "http://[::1]:8200/"


def test_a_run_shows_films_and_ends(make_mission, bundle_file, closed_port, tmp_path, monkeypatch):
    pytest.importorskip("av")
    monkeypatch.chdir(tmp_path)
    process = start_tokt(
        # Far more frames than the film needs: a busy machine must not come to their end before.
        *("run", "--bundle", bundle_file, "--source", make_mission([[(1, 1)], []] * 400)),
        *("--udp", f"127.0.0.1:{closed_port}", "--rate", "10", "--view", "0"),
        *("--view-host", "127.0.0.1", "--view-record", tmp_path / "dive.mp4"),
    )
    line = process.stderr.readline()
    port, token = re.fullmatch(r"view: http://127.0.0.1:(\d+)/\?token=(\S+)\n", line).groups()
    assert (tmp_path / ".tokt" / "view-token").read_text().strip() == token
    until(lambda: ask(port, f"/picture?token={token}")[0] == 200)
    assert ask(port, "/picture")[0] == 401
    part = tmp_path / "dive.mp4.part"
    until(lambda: part.stat().st_size > 10_000)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=MAX_S)
    assert process.returncode == 0 and "frames in" in err and "Traceback" not in err
    assert len(frames_of(tmp_path / "dive.mp4")) > 5


def test_a_run_that_is_killed_leaves_no_view_behind(make_mission, bundle_file, closed_port):
    """The next one has the port, and at the old one's page a reader sees that it died."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    process = start_tokt(
        *("run", "--bundle", bundle_file, "--source", make_mission([[]] * 150), "--rate", "5"),
        *("--udp", f"127.0.0.1:{closed_port}", "--view", port, "--watchdog"),
    )
    try:
        until(lambda: ask(port, "/picture")[0] == 200)
        (runtime,) = psutil.Process(process.pid).children()
        before = runtime.children()
        with socket.create_connection(("127.0.0.1", port), timeout=MAX_S) as opened:
            opened.sendall(STREAM % port)
            stream_parts(opened, lambda jpeg: True)
            runtime.kill()
            data = b"".join(iter(lambda: opened.recv(65_536), b""))
        assert data.endswith(b"--frame--\r\n")
        psutil.wait_procs(before, MAX_S)
        assert not any(each.is_running() for each in before)
        until(lambda: ask(port, "/picture")[0] == 200)
    finally:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=MAX_S)
    assert err.count("ended with signal 9") == 1 and "Traceback" not in err, err
