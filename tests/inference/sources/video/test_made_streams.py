"""What video is tested with is what it says: the pictures, their packets, and bad networks."""

import socket
import threading
import time
from contextlib import contextmanager, suppress

import av
import numpy as np
import pytest

from .network import GARBAGE, Network
from .packets import MAX_SEQ, MAX_TIMESTAMP, RTCP, rtp_packets, sdp, sequence_of
from .pictures import NUMBERS, PLACES, bgr, i420, number_at, number_of, place_of
from .senders import free_port

OPEN_S = 120.0


@pytest.mark.parametrize("size", [(96, 64), (1920, 1080)])
def test_a_picture_carries_its_number(size):
    for number in (0, 1, 77_777, NUMBERS - 1):
        assert number_of(i420(number, size)) == number_of(bgr(number, size)) == number
        assert number_at(*place_of(number)) == number % PLACES
    hurt = bgr(5, size)
    hurt[:, : size[0] // 2] = 128
    assert number_of(hurt) is None


@contextmanager
def sent_again_and_again(units, codec, port, seq, timestamp, **settings):
    """One stream of the same pictures without an end, to a port of the loopback."""
    ended = threading.Event()

    def send():
        first, stamp = seq, timestamp
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not ended.is_set():
                capture = rtp_packets(units, codec, seq=first, timestamp=stamp, **settings)
                for packet in capture:
                    away = port + (packet.kind == RTCP)
                    with suppress(OSError):
                        out.sendto(packet.data, ("127.0.0.1", away))
                    time.sleep(5e-4)
                first = (sequence_of(capture[-1].data) + 1) % MAX_SEQ
                stamp = (stamp + units[-1].pts + 3000) % MAX_TIMESTAMP

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_ffmpeg_reads_our_packets(film, codec, truth, tmp_path):
    """Aggregated and in fragments, with reports, and over the end of both counters."""
    port, description = free_port(), tmp_path / "it.sdp"
    description.write_text(sdp(port, codec))
    options = {"protocol_whitelist": "file,udp,rtp", "reorder_queue_size": "0"}
    counters = {"seq": MAX_SEQ - 30, "timestamp": MAX_TIMESTAMP - 9000}
    found = {}
    with (
        sent_again_and_again(film, codec, port, mtu=500, report_every=10, **counters),
        av.open(str(description), options=options, timeout=OPEN_S) as container,
    ):
        for packet in container.demux(video=0):
            with suppress(av.error.InvalidDataError):  # it joined between two key pictures
                for frame in packet.decode():
                    picture = frame.to_ndarray(format="yuv420p")
                    found[number_of(picture)] = picture
            if truth.keys() <= found.keys():
                break
    assert [number for number in truth if not np.array_equal(found[number], truth[number])] == []


def test_a_network_without_faults_passes_everything_on_and_is_the_same_each_time(capture):
    assert Network().over(capture) == capture
    faults = {"loss": 0.1, "burst": 3, "reorder": 0.1, "duplicate": 0.1, "garbage": 0.1}
    once, again, other = (Network(seed, **faults).over(capture) for seed in (1, 1, 2))
    assert once == again != other


@pytest.mark.parametrize(("loss", "burst"), [(0.3, 1), (0.05, 8)])
def test_a_network_loses_its_share(loss, burst):
    network = Network(3, loss=loss, burst=burst)
    lost = np.array([not network.pass_on(b"%d" % n) for n in range(30_000)])
    assert lost.mean() == pytest.approx(loss, rel=0.15)
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
