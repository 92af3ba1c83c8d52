"""The cameras and networks that video is tested with do what they say."""

import socket
import struct
import threading
import time
from contextlib import contextmanager, suppress
from io import BytesIO
from urllib.parse import urlsplit

import av
import numpy as np
import pytest

from tests.waiting import until

from .encoding import decoded, encode
from .mjpeg_server import FAULTS
from .network import GARBAGE, Network
from .packets import (
    MAX_SEQ,
    MAX_TIMESTAMP,
    RTCP,
    annex_b,
    joined_units,
    merged,
    nal_units,
    rtp_packets,
    sdp,
    sequence_of,
    transport_stream,
)
from .pictures import NUMBERS, PLACES, bgr, i420, number_at, number_of, place_of
from .relay import rtsp_relay, udp_relay
from .senders import (
    ffmpeg_rtp,
    ffmpeg_ts,
    free_port,
    gst_rtp,
    mjpeg,
    needs_ffmpeg,
    needs_gst,
    needs_gst_rtsp,
    rtsp,
)

OPEN_S = 120.0


@pytest.mark.parametrize("size", [(96, 64), (320, 240), (1920, 1080)])
def test_a_picture_carries_its_number(size):
    for number in (0, 1, 77_777, NUMBERS - 1):
        assert number_of(i420(number, size)) == number_of(bgr(number, size)) == number
        assert number_at(*place_of(number)) == number % PLACES
    hurt = bgr(5, size)
    hurt[:, : size[0] // 2] = 128
    assert number_of(hurt) is None


@pytest.mark.parametrize(
    "settings",
    [
        {"bitrate": 60_000},
        {"slices": 2},
        {"bframes": 2, "zerolatency": False},
        {"intra_refresh": True},
        {"size": (96, 64), "bitrate": 100_000},
    ],
)
def test_numbers_are_read_after_coding(codec, settings):
    units = encode(codec, range(500, 530), **settings)
    found = list(decoded(units, codec))
    assert [number for number, _ in found] == list(range(500, 530))
    assert [number_of(picture) for _, picture in found] == list(range(500, 530))
    assert units[0].key and len(nal_units(units[1].data)) == settings.get("slices", 1)


def test_nal_units_are_put_together_as_they_were(film):
    for unit in film:
        assert nal_units(annex_b(nal_units(unit.data))) == nal_units(unit.data)


@contextmanager
def sent_again_and_again(units, codec, port, **settings):
    """One stream of the same pictures without an end, to a port of the loopback."""
    ended = threading.Event()

    def send():
        seq, timestamp = settings.pop("seq", 0), settings.pop("timestamp", 0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not ended.is_set():
                capture = rtp_packets(units, codec, seq=seq, timestamp=timestamp, **settings)
                for packet in capture:
                    away = port + (packet.kind == RTCP)
                    with suppress(OSError):
                        out.sendto(packet.data, ("127.0.0.1", away))
                    time.sleep(5e-4)
                seq = (sequence_of(capture[-1].data) + 1) % MAX_SEQ
                timestamp = (timestamp + units[-1].pts + 3000) % MAX_TIMESTAMP

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def pictures_of(url, wanted, **options):
    """Some of the pictures that FFmpeg's own reader makes of a stream, by number."""
    found = {}
    with av.open(str(url), options=options, timeout=OPEN_S) as container:
        for packet in container.demux(video=0):
            with suppress(av.error.InvalidDataError):  # it joined between two key pictures
                for frame in packet.decode():
                    picture = frame.to_ndarray(format="yuv420p")
                    found[number_of(picture)] = picture
            if wanted(found):
                return found
    raise AssertionError(f"the stream ended: {sorted(filter(None, found))}")


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"mtu": 200},
        {"aggregate": False},
        {"seq": MAX_SEQ - 30, "timestamp": MAX_TIMESTAMP - 9000},
    ],
)
def test_ffmpeg_reads_our_packets(film, codec, truth, tmp_path, settings):
    port = free_port()
    (tmp_path / "it.sdp").write_text(sdp(port, codec))
    with sent_again_and_again(film, codec, port, report_every=10, **settings):
        found = pictures_of(
            tmp_path / "it.sdp",
            lambda found: truth.keys() <= found.keys(),
            protocol_whitelist="file,udp,rtp",
            reorder_queue_size="0",
        )
    assert [number for number in truth if not np.array_equal(found[number], truth[number])] == []


def test_ffmpeg_reads_our_transport_stream(film, codec, truth):
    data = b"".join(packet.data for packet in transport_stream(film, codec))
    with av.open(BytesIO(data), format="mpegts") as container:
        found = [frame.to_ndarray(format="yuv420p") for frame in container.decode(video=0)]
    assert all(map(np.array_equal, found, truth.values())) and len(found) == len(truth)


def test_a_capture_is_one_stream(film, codec):
    capture = rtp_packets(film, codec, seq=MAX_SEQ - 2, mtu=500, report_every=20)
    media = [packet for packet in capture if packet.kind != RTCP]
    assert [sequence_of(packet.data) for packet in media[:4]] == [65534, 65535, 0, 1]
    assert max(len(packet.data) for packet in media) == 500
    last = {packet.number: packet.data[1] >> 7 for packet in media}
    assert set(last.values()) == {1} and len(last) == len(film)
    assert sum(packet.data[1] >> 7 for packet in media) == len(film)
    kind, header = (28, 1) if codec == "h264" else (49 << 1, 2)
    parts = [
        packet.data[12:]
        for packet in media
        if packet.data[12] & (0x7E if header == 2 else 31) == kind
    ]
    starts, ends = (sum(bool(part[header] & bit) for part in parts) for bit in (0x80, 0x40))
    assert 0 < starts == ends < len(parts)
    reports = [packet.data for packet in capture if packet.kind == RTCP]
    assert [struct.unpack("!I", report[20:24])[0] for report in reports] == [
        0,
        *(sum(packet.number < number for packet in media) for number in (20, 40)),
    ]
    two = merged(capture, rtp_packets(film, codec, ssrc=7))
    assert [packet.t for packet in two] == sorted(packet.t for packet in two)


def test_pictures_of_another_size_in_one_stream(codec):
    small = encode(codec, range(15), key_every=15)
    large = encode(codec, range(15, 30), (640, 480), key_every=15)
    found = list(decoded(joined_units(small, large), codec))
    assert [number_of(picture) for _, picture in found] == list(range(30))
    assert {picture.shape for _, picture in found} == {(360, 320), (720, 640)}


def test_a_network_without_faults_passes_everything_on(capture):
    assert Network().over(capture) == capture


def test_a_network_is_the_same_each_time(capture):
    faults = {"loss": 0.1, "burst": 3, "reorder": 0.1, "duplicate": 0.1, "garbage": 0.1}
    once, again, other = (Network(seed, **faults).over(capture) for seed in (1, 1, 2))
    assert once == again != other


@pytest.mark.parametrize(("loss", "burst"), [(0.01, 1), (0.3, 1), (0.05, 8)])
def test_a_network_loses_its_share(loss, burst):
    network = Network(3, loss=loss, burst=burst)
    lost = np.array([not network.pass_on(b"%d" % n) for n in range(100_000)])
    assert lost.mean() == pytest.approx(loss, rel=0.15) and network.lost == lost.sum()
    ends = np.flatnonzero(np.diff(np.r_[0, lost, 0]))
    assert np.mean(ends[1::2] - ends[::2]) == pytest.approx(max(burst, 1 / (1 - loss)), rel=0.2)


def test_a_network_reorders_repeats_and_invents(capture):
    data = [packet.data for packet in capture]
    late = [packet.data for packet in Network(4, reorder=0.2).over(capture)]
    assert late != data and len(set(late) - set(data)) == 0 and len(late) > len(data) - 4
    twice = [packet.data for packet in Network(4, duplicate=0.2).over(capture)]
    assert len(twice) > len(data) and list(dict.fromkeys(twice)) == data
    for kind in GARBAGE:
        more = [packet.data for packet in Network(4, garbage=0.2, kinds=(kind,)).over(capture)]
        assert len(more) > len(data) and [each for each in more if each in set(data)] == data


LIVE = [
    pytest.param(ffmpeg_rtp, marks=needs_ffmpeg),
    pytest.param(ffmpeg_ts, marks=needs_ffmpeg),
    pytest.param(gst_rtp, marks=needs_gst),
    pytest.param(rtsp, marks=needs_gst_rtsp),
    mjpeg,
]


def read_live(camera, folder, wanted, **options):
    """A live camera's pictures by FFmpeg's reader."""
    url = camera.url
    if url.startswith("rtp"):
        (folder / "it.sdp").write_text(sdp(urlsplit(url).port, camera.film.codec))
        url, options = folder / "it.sdp", {"protocol_whitelist": "file,udp,rtp", **options}
    return pictures_of(url, wanted, **options)


@pytest.mark.parametrize("make", LIVE)
def test_a_live_camera_is_read_paused_and_started_anew(make, tmp_path):
    with make(tmp_path) as camera:
        found = read_live(camera, tmp_path, lambda found: len(found) >= 3)
        times = [camera.stamps.of(number) for number in found]
        assert times == sorted(times) and times[-1] < time.monotonic()
        camera.pause()
        before, url = camera.stamps.last(), camera.url
        camera.restart()
        assert camera.url == url
        again = read_live(camera, tmp_path, lambda found: len(found) >= 2)
        assert min(again) > before
    assert not camera.cpu_s()


@needs_gst_rtsp
@pytest.mark.parametrize("auth", ["basic", "digest"])
def test_an_rtsp_camera_asks_for_its_password(auth, tmp_path):
    with rtsp(tmp_path, user="rov", password="deep", auth=auth) as camera:
        with pytest.raises(av.error.HTTPUnauthorizedError):
            pictures_of(camera.url.replace("deep", "flat"), any)
        assert pictures_of(camera.url, any, rtsp_transport="tcp")


@needs_gst_rtsp
def test_a_bad_network_before_an_rtsp_session(tmp_path):
    network = Network(loss=0.2)
    with rtsp(tmp_path) as camera, rtsp_relay(network, camera.url) as url:
        assert pictures_of(url, lambda found: found and network.lost > 5, rtsp_transport="udp")


def test_a_bad_network_before_a_port(capture):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as into:
        into.bind(("127.0.0.1", 0))
        into.settimeout(OPEN_S)
        network = Network(1, loss=0.2, reorder=0.2)
        expected = [packet.data for packet in Network(1, loss=0.2, reorder=0.2).over(capture)]
        with udp_relay(network, into.getsockname()[1]) as port:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
                for packet in capture:
                    out.sendto(packet.data, ("127.0.0.1", port))
            assert [into.recv(1 << 16) for _ in expected] == expected


@pytest.mark.parametrize("fault", FAULTS)
def test_a_camera_of_jpegs_with_a_fault(fault, tmp_path):
    with mjpeg(tmp_path) as camera:
        port = urlsplit(camera.url).port
        with socket.create_connection(("127.0.0.1", port), OPEN_S) as client:
            path = f"/stream.mjpg?fault={fault.replace(' ', '%20')}"
            client.sendall(f"GET {path} HTTP/1.0\r\n\r\n".encode())
            said = bytearray()

            def more():
                data = client.recv(1 << 16)
                said.extend(data)
                return not data or said.count(b"--frame") > 9

            until(more)
    head = said.split(b"\r\n\r\n")[0]
    assert (b"multipart/x-mixed-replace" in head) == (fault not in ("page", "missing"))
    assert (b"Content-Length" in said) == (fault not in ("no length", "page"))
    assert (b"no picture at all" in said) == (fault == "garbage")
    assert head.startswith(b"HTTP/1.0 404" if fault == "missing" else b"HTTP/1.0 200")
