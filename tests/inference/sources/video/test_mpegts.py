"""MPEG-TS over UDP: the units that FFmpeg's demultiplexer finds, and nothing where some is lost."""

import random
import socket
import sys
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from itertools import pairwise

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.live import bound_socket
from tests.tiers import scaled
from tests.waiting import until
from tokt.inference.reason import Reason
from tokt.inference.sources.video.mpegts import (
    PACKET,
    TransportReader,
    TransportStream,
    count_drops,
    read_mpegts,
    received,
)
from tokt.inference.sources.video.newest import StreamLostError

from .encoding import encode
from .packets import transport_stream
from .reading import reading, words_of
from .senders import Film, ffmpeg_ts, free_port, needs_ffmpeg

VIDEO_PID = 0x100


def datagrams_of(units, codec):
    return [packet.data for packet in transport_stream(units, codec)]


def pictures(datagrams, reader=None):
    """What a reader makes of datagrams: the pictures by their times, and the faults."""
    reader, shown, faults = reader or TransportReader(), {}, []
    for number, data in enumerate(datagrams):
        now = number * 1e-4
        for one in reader.datagram(data, now):
            if one.picture is None:
                faults.append(one.fault)
            else:
                shown[one.taken_s] = one.picture.to_ndarray(format="yuv420p")
    return shown, faults


def with_lengths(data):
    """The stream with the length of each of the video's PES packets, as some senders write it."""
    packets = [bytearray(data[at : at + PACKET]) for at in range(0, len(data), PACKET)]
    video = [p for p in packets if is_video(p)]
    payload_at = [4 + (1 + p[4] if p[3] & 0x20 else 0) for p in video]
    begins = [place for place, p in enumerate(video) if p[1] & 0x40]
    for first, end in zip(begins, [*begins[1:], len(video)], strict=True):
        size = sum(PACKET - at for at in payload_at[first:end]) - 6
        at = payload_at[first]
        video[first][at + 4 : at + 6] = size.to_bytes(2, "big")
    return b"".join(packets)


def in_datagrams(data, count=7):
    return [data[at : at + count * PACKET] for at in range(0, len(data), count * PACKET)]


def is_video(packet):
    return int.from_bytes(packet[1:3], "big") & 0x1FFF == VIDEO_PID


def packets_of(units, codec, lengths=False):
    """The stream's packets, and which of them are the video's: all, and those that begin a PES."""
    data = b"".join(datagrams_of(units, codec))
    packets = in_datagrams(with_lengths(data) if lengths else data, 1)
    video = [place for place, packet in enumerate(packets) if is_video(packet)]
    return packets, video, [place for place in video if packets[place][1] & 0x40]


@pytest.mark.parametrize("lengths", [False, True])
def test_the_units_are_those_of_ffmpegs_demultiplexer(film, codec, lengths):
    data = b"".join(datagrams_of(film, codec))
    if lengths:
        data = with_lengths(data)
    with av.open(BytesIO(data), format="mpegts") as container:
        packets = [p for p in container.demux(video=0) if p.size]
    stream = TransportStream()
    units = [unit for piece in in_datagrams(data) for unit in stream.add(piece, 0.0)]
    assert len(units) == len(packets) - (not lengths), "the last one's end is known by a length"
    for unit, packet in zip(units, packets, strict=False):
        assert unit.timestamp == packet.pts
        assert bool(unit.units) is not bool(unit.fault)
        assert unit.fault or unit.data.replace(b"\0\0\0\1", b"\0\0\1") == bytes(packet).replace(
            b"\0\0\0\1", b"\0\0\1"
        )
    assert [bool(unit.fault) for unit in units] == [True] * 3 + [False] * (len(units) - 3)


@pytest.fixture(scope="module")
def sent(film, codec):
    """The datagrams, and what they show where nothing is lost."""
    datagrams = datagrams_of(film, codec)
    return datagrams, pictures(datagrams)[0]


def test_pictures_are_those_that_were_encoded(sent, film, truth):
    shown = sent[1]
    first = min(shown)
    by_number = {round((t - first) * 30): picture for t, picture in shown.items()}
    offset = 15  # the first key picture comes before the stream is believed
    assert len(shown) == len(film) - offset - 1
    for number, picture in by_number.items():
        assert np.array_equal(picture, truth[number + offset])


@settings(max_examples=scaled(40), deadline=None)
@given(seed=st.integers(0, 2**32), kind=st.sampled_from(["some", "burst", "one", "garbage"]))
def test_whatever_is_lost_repeated_or_reordered_no_picture_differs(sent, seed, kind):
    datagrams, truth = sent
    rng = random.Random(seed)
    got = list(datagrams)
    if kind == "one":
        del got[rng.randrange(len(got))]
    elif kind == "burst":
        at = rng.randrange(len(got))
        del got[at : at + rng.choice((2, 3, 5, 8, 15, 17))]
    elif kind == "some":
        share = rng.choice((0.01, 0.05, 0.2))
        got = [data for data in got if rng.random() > share]
    for _ in range(rng.choice((0, 1, 5))):
        at = rng.randrange(len(got) - 1)
        way = rng.randrange(4)
        if way == 0:
            got[at], got[at + 1] = got[at + 1], got[at]
        elif way == 1:
            got.insert(at, got[max(0, at - rng.choice((0, 1, 4)))])
        elif way == 2:
            got.insert(at, rng.randbytes(rng.choice((0, 1, 3, 40, 188, 1316))))
        else:
            got.insert(at, bytes([0x47]) + rng.randbytes(rng.choice((0, 3, 187, 1315))))
    shown, _ = pictures(got)
    for t, picture in shown.items():
        assert t in truth
        assert np.array_equal(picture, truth[t])


def test_after_a_loss_there_is_no_picture_up_to_the_next_key_picture(sent):
    datagrams, truth = sent
    shown, faults = pictures(datagrams[:40] + datagrams[41:])
    missing = sorted(set(truth) - set(shown))
    assert 1 <= len(missing) <= 15
    lost = [fault for fault in faults if "packets of it are lost" in str(fault)]
    assert lost[0].reason is Reason.INCOMPLETE


def test_a_stream_of_which_each_picture_is_damaged_does_not_count_as_late(sent):
    datagrams, _ = sent
    reader = TransportReader()
    pictures(datagrams[:60], reader)
    faults = []
    for number, data in enumerate(datagrams[60:]):
        faults += [one.fault for one in reader.datagram(data, 1.0 + number / 10, lost=True)]
    assert len(faults) > 5
    assert all(faults)


def test_a_datagram_or_a_packet_that_comes_twice_costs_nothing(sent):
    datagrams, truth = sent
    packets = [p for data in datagrams for p in in_datagrams(data, 1)]
    for twice in ([data for data in datagrams for _ in range(2)], [p + p for p in packets]):
        assert pictures(twice)[0].keys() == truth.keys()


def test_all_of_a_pictures_packets_lost_is_noticed_where_lengths_end_it_early(codec):
    packets, _, begins = packets_of(encode(codec, 40, key_every=20), codec, lengths=True)
    shown, faults = pictures(packets[: begins[25]] + packets[begins[26] :])
    assert len(shown) == len(pictures(packets)[0]) - 15
    assert any("packets of it are lost" in str(fault) for fault in faults)


def test_whole_pictures_lost_in_a_run_of_16_are_told_where_lengths_end_them(film, codec):
    packets, video, begins = packets_of(film, codec, lengths=True)
    first, later = begins[20], begins[23]
    last = packets[max(place for place in video if place < first)]
    rest = packets[later:]
    shift = ((last[3] & 15) + 1 - rest[0][3]) & 15  # as if their number were a multiple of 16
    moved = [
        p[:3] + bytes([p[3] & 0xF0 | (p[3] + shift) & 15]) + p[4:] if is_video(p) else p
        for p in rest
    ]
    _, faults = pictures(packets[:first] + moved)
    assert any("pictures after it are missing" in str(fault) for fault in faults)


@pytest.mark.parametrize(("count", "told"), [(340, ""), (356, "a part of it is missing")])
def test_a_picture_that_may_go_on_in_the_next_pes_packet_is_none(count, told):
    """A sender that writes lengths can give no PES packet more than 64 kB."""
    packets, video, _ = packets_of(encode("h264", 12), "h264", lengths=True)
    number, stream = packets[video[-1]][3] & 15, TransportStream()
    ticks = [unit.timestamp for piece in packets for unit in stream.add(piece, 0.0)][-1] + 3000
    time = bytes([0x21 | ticks >> 30 << 1, ticks >> 22 & 255, ticks >> 14 & 254 | 1])
    time += bytes([ticks >> 7 & 255, ticks << 1 & 254 | 1])
    head = b"\0\0\1\xe0" + (count * 184 - 6).to_bytes(2, "big") + b"\x80\x80\5" + time
    pes = (head + b"\0\0\0\1\x65\x88").ljust(count * 184, b"x")
    data = b""
    for place in range(count):
        pid = b"\x41\0" if place == 0 else b"\1\0"
        counted = bytes([0x10 | (number + 1 + place) & 15])
        data += b"G" + pid + counted + pes[place * 184 : (place + 1) * 184]
    assert [unit.fault for unit in stream.add(data, 0.0)] == [told]


def test_a_run_of_16_lost_packets_is_told_by_the_length(codec):
    film = encode(codec, 30, size=(480, 320), key_every=10, bitrate=2_000_000)
    packets, video, begins = packets_of(film, codec, lengths=True)
    within = set(video) - set(begins)
    run = next(n for n in video if n > 200 and all(n + k in within for k in range(16)))
    shown, faults = pictures(packets[:run] + packets[run + 16 :])
    truth, _ = pictures(packets)
    assert all(np.array_equal(picture, truth[t]) for t, picture in shown.items())
    assert any("a part of it is missing" in str(fault) for fault in faults)


def test_a_run_of_16_that_takes_whole_pictures_along_is_told_by_the_times(film, codec):
    packets, video, begins = packets_of(film, codec)
    truth, _ = pictures(packets)
    runs = [{*video[at : at + 16]} for at in range(150, len(video) - 80, 7)]
    several = [run for run in runs if len(run.intersection(begins)) > 1]
    assert len(several) > 5
    for run in several[::3]:
        shown, _ = pictures([p for n, p in enumerate(packets) if n not in run])
        assert all(np.array_equal(picture, truth[t]) for t, picture in shown.items())


def test_damaged_and_scrambled_packets_are_no_picture(sent):
    datagrams, truth = sent
    for at, bit in ((1, 0x80), (3, 0x40)):
        changed = bytearray(datagrams[40])
        changed[PACKET + at] |= bit
        shown, faults = pictures([*datagrams[:40], bytes(changed), *datagrams[41:]])
        assert any("damaged or scrambled" in str(fault) for fault in faults)
        assert len(shown) < len(truth)


def test_a_table_with_a_wrong_sum_is_not_believed(film, codec):
    datagrams = datagrams_of(film, codec)
    changed = [data.replace(b"\x02\xb0", b"\x02\xb1") for data in datagrams]  # each PMT's length
    assert pictures(changed) == ({}, [])


def test_other_video_and_plain_rtp_are_named(film):
    sink = BytesIO()
    with av.open(sink, "w", format="mpegts") as container:
        stream = container.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt = 320, 240, "yuv420p"
        frame = av.VideoFrame.from_ndarray(np.zeros((360, 320), np.uint8), "yuv420p")
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with pytest.raises(StreamLostError, match="no video of H"):
        pictures([sink.getvalue()])
    with pytest.raises(StreamLostError, match="rtp://"):
        pictures([b"\x80\x60" + bytes(10) + b"unit"] * 30)


def test_times_go_on_where_33_bits_begin_anew(codec):
    film = [replace(u, pts=u.pts + 2**33 - 60_000) for u in encode(codec, 60, key_every=10)]
    times = sorted(pictures(datagrams_of(film, codec))[0])
    steps = {round(after - before, 4) for before, after in pairwise(times)}
    assert steps == {round(1 / 30, 4)}


def whole_of(newest):
    """The newest reading, if it is of a picture."""
    taken = newest.take(0.1)
    return taken[1] if taken and taken[1].picture is not None else None


@pytest.mark.parametrize("form", ["udp://127.0.0.1:{}", "udp://@127.0.0.1:{}"])
def test_a_port_is_listened_on(sent, form):
    datagrams, _ = sent
    port = free_port()

    def sends():
        for data in datagrams:
            sender.sendto(data, ("127.0.0.1", port))
        return whole_of(newest)

    with (
        reading(read_mpegts, form.format(port)) as (newest, words),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        until(sends)
    assert words == []


def test_a_port_that_another_has_is_told():
    with bound_socket() as other:
        words = words_of(read_mpegts, f"udp://127.0.0.1:{other.getsockname()[1]}")
    assert "nobody can listen on" in words


@needs_ffmpeg
def test_ffmpegs_own_sender_is_read(tmp_path):
    with (
        ffmpeg_ts(tmp_path, Film(key_every=10)) as camera,
        reading(read_mpegts, camera.url) as (newest, _),
    ):
        picture = until(lambda: whole_of(newest)).picture
    assert (picture.width, picture.height) == (320, 240)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_what_this_computer_drops_is_told():
    with bound_socket() as port:
        port.settimeout(1.0)
        port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        count_drops(port)
        counts = []
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for _ in range(2):
                for _ in range(50):
                    sender.sendto(bytes(1316), port.getsockname())
                counts.append(received(port)[2])
                with suppress(TimeoutError):
                    while received(port):
                        port.settimeout(0.01)
    assert counts[0] == 0
    assert counts[1] > 0
