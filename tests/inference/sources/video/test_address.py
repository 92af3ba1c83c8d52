"""Addresses of video: what is meant, what is refused, and that nobody sees a password."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.features.common.address import without_credentials
from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig
from tokt.inference.sources.video.address import VideoAddress, is_video_source, parse_video_sources
from tokt.inference.sources.video.driver import open_drivers


def test_what_users_write():
    camera = VideoAddress.parse("rtsp://pilot:p%40ss@192.168.2.2:8554/video?a=1&b=2")
    assert (camera.user, camera.password, camera.port) == ("pilot", "p@ss", 8554)
    assert camera.url == camera.name == "rtsp://192.168.2.2:8554/video?a=1&b=2"
    assert VideoAddress.parse("rtp://:5600").host == ""
    stream = VideoAddress.parse("rtp://127.0.0.1:5600?codec=h265")
    assert (stream.host, stream.port, stream.options) == ("127.0.0.1", 5600, {"codec": "h265"})
    usb = VideoAddress.parse("v4l2:/dev/video0?size=1280x720&rate=30&format=mjpeg")
    assert usb.device == "/dev/video0" and usb.options["size"] == "1280x720"
    pair = parse_video_sources("rtsp://a/x,1?y=1,2,rtsp://b/x")
    assert [each.url for each in pair] == ["rtsp://a/x,1?y=1,2", "rtsp://b/x"]
    assert not is_video_source("dive.mp4") and not is_video_source("pymba:0")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rtp://:0", "write the port to listen on"),
        ("udp://host", "write the port to listen on"),
        ("rtsp:///x", "names no host"),
        ("rtsp:host/x", "begins with rtsp://"),
        ("rtsp://h:99999/x", "[Pp]ort"),
        ("rtp://:5600?codec=vp8", "codec is h264 or h265, not 'vp8'"),
        ("rtp://:5600?codecs=h264", "unknown option 'codecs'"),
        ("udp://:5600?codec=h264", "unknown option 'codec' .it has none"),
        ("v4l2:video0", "write the device"),
        ("v4l2:/dev/video0?size=big", "size is WIDTHxHEIGHT"),
        ("v4l2:/dev/video0?rate=0", "rate is frames per second"),
        ("v4l2:/dev/video0?format=png", "format is yuyv or mjpeg or h264"),
        ("rtsp://a/1,rtsp://a/1", "both rtsp://a/1"),
        ("rtsp://a/1,rtsp://b/1,rtsp://c/1", "one camera or two, not 3"),
    ],
)
def test_what_cannot_be_meant(text, words):
    refuses(words, parse_video_sources, text)


@given(
    st.sampled_from(["rtsp", "rtspu", "rtp", "udp", "http", "https"]),
    st.text(
        st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="/?#@&"), min_size=9
    ).map("~{}".format),  # what no help has in it
    st.sampled_from(["", "/x", ":77/a?b=c", "/user={}&password={}&channel=1", ":5?token={}"]),
)
def test_no_password_is_ever_shown(scheme, secret, rest):
    text = f"{scheme}://u{secret}:{secret}@host" + rest.replace("{}", secret)
    try:
        shown = repr(VideoAddress.parse(text)) + VideoAddress.parse(text).name
    except ToktError as error:
        shown = str(error)
    shown += RunConfig.of({"source": text}).to_toml() + without_credentials(f"no answer: {text}")
    assert secret not in shown


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=9).map("~{}".format))
def test_a_password_that_is_not_quoted_is_not_shown(secret):
    for text in (f"rtsp://pilot:{secret}@host/x", f"rtsp:/pilot:{secret}@host", f"rtp:{secret}@h"):
        try:
            shown = repr(open_drivers(parse_video_sources(text), SYSTEM_CLOCK))
        except ToktError as error:
            shown = str(error)
        shown += RunConfig.of({"source": text}).to_toml()
        assert secret not in shown


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("rtsp://u:p,a/ss@h/x", "rtsp://h/x"),
        ("rtsp://u:p,a/s@h/a,rtsp://v:q,/r@h/b", "rtsp://h/a,rtsp://h/b"),
        ("http://admin:pa ss@h/x", "http://h/x"),
        ("rtsp://h:554/a,v4l2:/dev/video0", "rtsp://h:554/a,v4l2:/dev/video0"),
        ("http://h/c?psw=a,b", "http://h/c?psw=..."),
        ("rtsp:/u:p@h", "rtsp:h"),
    ],
)
def test_what_is_shown_of_an_address(text, shown):
    assert without_credentials(text) == shown


def test_a_blank_may_follow_the_comma():
    for text in ("rtsp://h/a, rtsp://h/b", "rtsp://h/a,RTSP://h/b"):
        assert [each.url for each in parse_video_sources(text)] == ["rtsp://h/a", "rtsp://h/b"]


def test_credentials_of_the_environment(monkeypatch):
    monkeypatch.setenv("TOKT_SOURCE_USER", "pilot")
    monkeypatch.setenv("TOKT_SOURCE_PASSWORD", "secret")
    found = VideoAddress.parse("rtsp://host/x").with_environment()
    assert (found.user, found.password) == ("pilot", "secret") and "secret" not in repr(found)
    own = VideoAddress.parse("rtsp://me:mine@host/x").with_environment()
    assert (own.user, own.password) == ("me", "mine")
