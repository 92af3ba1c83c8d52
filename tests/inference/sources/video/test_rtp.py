"""RTP: packets, order and clocks; streams over bad networks: no picture that was not sent."""

import pickle
import re
import struct
from dataclasses import replace

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.inference.reason import Reason
from tokt.inference.sources.video.access_units import CODECS
from tokt.inference.sources.video.newest import StreamLostError
from tokt.inference.sources.video.rtp import (
    RTP_HZ,
    Delay,
    PacketOrder,
    RtpPacket,
    SenderClock,
    is_rtcp,
    parse_rtp,
    parse_sender_report,
)
from tokt.inference.sources.video.rtp_stream import RtpStream

from .encoding import decoded, encode
from .network import Network, cut
from .packets import (
    RTP,
    SSRC,
    Packet,
    annex_b,
    follow,
    joined_units,
    merged,
    nal_units,
    rtp_packets,
    sender_report,
)


def read(capture, codec="h264"):
    """What a reader makes of a capture, by the packets' own times."""
    stream, readings = RtpStream(CODECS[codec]), []
    for packet in capture:
        if stream.due() <= packet.t:
            readings += stream.expired(stream.due())
        readings += stream.datagram(packet.data, packet.t)
    return [*readings, *stream.expired(capture[-1].t + 1.0)]


def marked(packet, on):
    """A packet with the marker, or without it."""
    return replace(
        packet, data=bytes([packet.data[0], packet.data[1] & 127 | on << 7]) + packet.data[2:]
    )


def stamped(packet, shift):
    stamp = (int.from_bytes(packet.data[4:8], "big") + shift).to_bytes(4, "big")
    return replace(packet, data=packet.data[:4] + stamp + packet.data[8:])


def is_set(packet, codec):
    return CODECS[codec].is_set(packet.data[12:])


def numbers(readings, truth):
    """The numbers of the pictures; each must be what the lossless stream decodes to."""
    known = {picture.tobytes(): number for number, picture in truth.items()}
    shown = [reading for reading in readings if reading.picture is not None]
    found = [known.get(one.picture.to_ndarray(format="yuv420p").tobytes()) for one in shown]
    assert None not in found, "a damaged picture is given as whole"
    return found


def faults(readings):
    return [(each.fault.reason, str(each.fault)) for each in readings if each.picture is None]


def test_without_faults_every_picture_is_whole(film, codec, truth):
    for more in ({}, {"aggregate": False}, {"mtu": 300}, {"seq": 65_500}, {"timestamp": 2**32 - 9}):
        readings = read(rtp_packets(film, codec, **more), codec)
        assert numbers(readings, truth) == list(range(60)) and faults(readings) == []


def test_a_sender_that_marks_no_end_is_one_picture_late(film, codec, truth):
    capture = [marked(packet, on=False) for packet in rtp_packets(film, codec)]
    assert numbers(read(capture, codec), truth) == list(range(59))


def test_a_sender_that_marks_each_slice_is_one_picture_late(codec):
    film = encode(codec, 30, key_every=10, slices=4)
    capture = rtp_packets(film, codec, aggregate=False, mtu=60_000)
    readings = read([marked(packet, on=True) for packet in capture], codec)
    assert numbers(readings, dict(decoded(film, codec))) == list(range(29))
    assert faults(readings) == []
    late = [marked(packet, on=True) if packet.number > 3 else packet for packet in capture]
    readings = read(late, codec)
    assert numbers(readings[-19:], dict(decoded(film, codec))) == list(range(10, 29))


def test_two_pictures_of_one_time(film, codec, truth):
    """A clock that counts 15 steps a second for 30 pictures."""
    capture = [
        stamped(packet, -3000 * (packet.number > 3 and packet.number % 2))
        for packet in rtp_packets(film, codec)
    ]
    assert numbers(read(capture, codec), truth) == list(range(60))


def test_parameter_sets_that_are_told_beside_the_stream(film, codec, truth):
    kind, stream, readings = CODECS[codec], RtpStream(CODECS[codec]), []
    for unit in nal_units(film[0].data):
        if kind.is_set(unit):
            stream.take_set(unit)
    bare = [
        replace(unit, data=annex_b(each for each in nal_units(unit.data) if not kind.is_set(each)))
        for unit in film
    ]
    for packet in rtp_packets(bare, codec):
        readings += stream.datagram(packet.data, packet.t)
    assert numbers(readings, truth) == list(range(60)) and faults(readings) == []


def test_what_holds_no_picture_costs_none(film, codec, truth):
    """Parameter sets of a time or with a marker of their own, and notes between two pictures."""
    capture = rtp_packets(film, codec, aggregate=False)
    for change in (lambda packet: stamped(packet, -10), lambda packet: marked(packet, on=True)):
        changed = [change(packet) if is_set(packet, codec) else packet for packet in capture]
        readings = read(changed, codec)
        assert numbers(readings, truth) == list(range(60)) and len(faults(readings)) < 2
    note = {"h264": b"\x06\x05\x04note\x80", "h265": b"\x4e\x01\x05\x04note\x80"}[codec]
    before = rtp_packets(film[:20], codec)
    seq = 1000 + len(before)
    told = [Packet(RTP, struct.pack("!BBHII", 0x80, 0xE0, seq, 183_400, SSRC) + note, 0.0, None)]
    after = rtp_packets(film[20:], codec, timestamp=183_456, seq=seq + 1)
    readings = read(follow(before, told, after, gap_s=0.03), codec)
    assert numbers(readings, truth) == list(range(60)) and faults(readings) == []


def test_several_slices_and_pictures_out_of_order(codec):
    for more in ({"slices": 4}, {"bframes": 2, "zerolatency": False, "preset": "veryfast"}):
        film = encode(codec, 30, key_every=10, **more)
        truth = dict(decoded(film, codec))
        readings = read(rtp_packets(film, codec), codec)
        assert sorted(numbers(readings, truth))[:27] == list(range(27)) and not faults(readings)
        lossy = read(Network(3, loss=0.05).over(rtp_packets(film, codec, mtu=300)), codec)
        numbers(lossy, truth)
        assert faults(lossy)


@pytest.mark.parametrize("share", ["first", "middle", "last"])
def test_what_is_lost_of_a_picture_is_missing_up_to_the_next_key_picture(share, film, codec, truth):
    capture = rtp_packets(film, codec, mtu=200)
    of = [place for place, packet in enumerate(capture) if packet.number == 20]
    lost = of[{"first": 0, "middle": len(of) // 2, "last": -1}[share]]
    readings = read(capture[:lost] + capture[lost + 1 :], codec)
    assert numbers(readings, truth) == [*range(20), *range(30, 60)]
    reasons = [reason for reason, _ in faults(readings)]
    assert reasons[0] is Reason.INCOMPLETE and set(reasons[2:]) == {Reason.DAMAGED}
    assert "key picture" in faults(readings)[0][1]


def test_a_picture_that_was_never_sent_is_missed(film, codec, truth):
    readings = read(rtp_packets([unit for unit in film if unit.number != 20], codec), codec)
    assert numbers(readings, truth) == [*range(20), *range(30, 60)]


def own_number(unit):
    """A NAL unit of H.264 whose picture parameter set is number 1, of sequence set 0."""
    before = {8: 0, 1: 2, 5: 2}.get(unit[0] & 31)  # Exp-Golomb numbers before the set's
    if before is None:
        return unit
    raw = unit[1:].replace(b"\0\0\3", b"\0\0")
    bits, at = f"{int.from_bytes(raw, 'big'):0{8 * len(raw)}b}".rstrip("0"), 0
    for _ in range(before):
        at += 2 * (bits.index("1", at) - at) + 1
    assert bits[at] == "1"
    bits = bits[:at] + "010" + bits[at + 1 :]
    bits += "0" * (-len(bits) % 8)
    made = int(bits, 2).to_bytes(len(bits) // 8, "big")
    return unit[:1] + re.sub(rb"\0\0(?=[\0-\3])", b"\0\0\3", made)


def test_a_picture_parameter_set_has_a_number_of_its_own():
    film = [
        replace(unit, data=annex_b([own_number(each) for each in nal_units(unit.data)]))
        for unit in encode("h264", 60, key_every=15)
    ]
    truth = dict(decoded(film, "h264"))
    assert numbers(read(rtp_packets(film)), truth) == list(range(60))
    missing = [unit for unit in film if unit.number != 20]
    assert numbers(read(rtp_packets(missing)), truth) == [*range(20), *range(30, 60)]


def test_a_key_picture_without_its_beginning_is_none(film, codec, truth):
    capture = rtp_packets(film, codec, aggregate=False)
    lost = next(place for place, packet in enumerate(capture) if packet.number == 30)
    readings = read(capture[:lost] + capture[lost + 1 :], codec)
    assert numbers(readings, truth) == [*range(30), *range(45, 60)]


def test_who_joins_waits_for_a_key_picture(film, codec, truth):
    capture = rtp_packets(film, codec)
    first = next(place for place, packet in enumerate(capture) if packet.number == 7)
    assert numbers(read(cut(capture, first), codec), truth) == list(range(15, 60))


def test_what_comes_late_or_twice_changes_nothing(capture, codec, truth):
    network = Network(1, reorder=0.2, duplicate=0.2, garbage=0.2)
    readings = read(network.over(capture), codec)
    # What the network still holds at the end never comes.
    assert numbers(readings, truth)[:50] == list(range(50)) and faults(readings[:50]) == []


@pytest.mark.parametrize(
    "change", [{"ssrc": 7, "seq": 3}, {"seq": 30_000}, {"payload_type": 98}, {"seq": 995}, {}]
)
def test_a_sender_that_begins_anew_loses_nothing(change, film, codec, truth):
    captures = rtp_packets(film, codec), rtp_packets(film, codec, timestamp=5, **change)
    readings = read(follow(*captures, gap_s=0.6), codec)
    assert numbers(readings, truth) == [*range(60), *range(60)] and faults(readings) == []


def test_parameter_sets_of_before_hold_for_nothing_that_follows(codec):
    """The sets of a key picture that is not whole are known; those of the next size are lost."""
    films = encode(codec, 15), encode(codec, range(100, 130), size=(160, 120), key_every=15)
    truth = dict(decoded(films[1], codec))
    first = rtp_packets(films[0], codec, aggregate=False, mtu=200)
    key = [place for place, packet in enumerate(first) if packet.number == 0]
    sets = {"h264": 2, "h265": 3}[codec]
    for change in ({"seq": 2000, "timestamp": 500_000}, {"ssrc": 7, "seq": 3}):
        second = rtp_packets(films[1], codec, aggregate=False, **change)
        capture = follow(first[: key[-1]] + first[key[-1] + 1 :], second[sets:])
        assert numbers(read(capture, codec), truth) == list(range(115, 130))


def test_a_second_stream_at_the_same_port_is_left_out(film, codec, truth):
    second = rtp_packets(encode(codec, 60, size=(160, 120)), codec, ssrc=9, seq=77)
    readings = read(merged(rtp_packets(film, codec), second), codec)
    assert numbers(readings, truth) == list(range(60))


def test_of_two_slow_streams_at_one_port_one_is_shown(codec):
    """Four pictures a second: each stream is silent while the other sends."""
    films = [encode(codec, range(first, first + 20), rate=4) for first in (0, 100)]
    truth = {**dict(decoded(films[0], codec)), **dict(decoded(films[1], codec))}
    second = rtp_packets(films[1], codec, ssrc=9, seq=77, start=0.125)
    readings = read(merged(rtp_packets(films[0], codec), second), codec)
    assert numbers(readings, truth) == list(range(20))


def test_another_size_follows(codec):
    films = encode(codec, 15), encode(codec, range(100, 115), size=(160, 120))
    truth = {**dict(decoded(films[0], codec)), **dict(decoded(films[1], codec))}
    readings = read(rtp_packets(joined_units(*films), codec), codec)
    assert numbers(readings, truth) == [*range(15), *range(100, 115)]


@settings(max_examples=scaled(120))
@given(
    seed=st.integers(0, 2**32),
    loss=st.floats(0, 0.3),
    burst=st.sampled_from([1.0, 3.0, 20.0]),
    more=st.tuples(*[st.sampled_from([0.0, 0.05])] * 3),
    mtu=st.sampled_from([150, 500, 1400]),
    first=st.integers(0, 100),
)
# A key picture right after the join came whole, and what follows it is lost.
@example(seed=2262, loss=0.25, burst=3.0, more=(0.0, 0.0, 0.0), mtu=1400, first=65)
def test_no_network_makes_a_picture_that_was_not_sent(
    film, codec, truth, seed, loss, burst, more, mtu, first
):
    reorder, duplicate, invented = more
    network = Network(seed, loss, burst, reorder, duplicate=duplicate, garbage=invented)
    capture = cut(rtp_packets(film, codec, mtu=mtu, report_every=10), first)
    passed = network.over(capture)
    shown = set(numbers(read(passed, codec), truth)) if passed else set()
    # A key picture all of which came, and what came whole after it, is shown. Its end is known by
    # what follows it, or by its marker once the reader has seen what markers mean.
    if not any(more):
        sent = [(one.number, one.data) for one in capture if one.number is not None]
        heard = {packet.data for packet in passed}
        came = [False, *(data in heard for _, data in sent), False]
        judged = marks = False
        for number in range(60):
            own = [place for place, (of, _) in enumerate(sent, 1) if of == number]
            whole = all(came[place] for place in own)
            followed = bool(own) and came[own[-1] + 1]
            key = number % 15 == 0 and sent[0][0] < number and (marks or followed)
            judged = whole and (judged or key)
            assert not judged or number in shown, number
            marks = marks or (whole and followed and came[own[0] - 1])


@given(st.binary(max_size=80), st.sampled_from([b"", b"\x80\x60", b"\xb0\xe0", b"\x80\xc8"]))
def test_any_bytes_are_a_packet_or_none(data, head):
    packet = parse_rtp(head + data, 1.0)
    assert packet is None or (packet.payload and packet.payload in head + data)
    report = parse_sender_report(head + data)
    assert report is None or (is_rtcp(head + data) and report[1] >= 0)


def test_a_packet_with_all_that_a_header_can_have():
    head = struct.pack("!BBHII", 0xB2, 0xE0, 7, 8, 9) + bytes(8) + b"\xbe\xde\0\1" + bytes(4)
    packet = parse_rtp(head + b"payload" + b"\0\0\3", 2.5)
    assert packet == RtpPacket(9, 7, 8, 96, True, b"payload", 2.5)


def test_a_sender_report():
    ssrc, utc, timestamp = parse_sender_report(sender_report(9, 2.25, 77, 1, 1))
    assert (ssrc, timestamp) == (9, 77) and utc % 1 == pytest.approx(0.25)
    unset = struct.pack("!BBHIIIIII", 0x80, 200, 6, 9, 17, 0, 77, 0, 0)
    assert parse_sender_report(unset) is None


def numbered(sequence, ssrc=1, arrived=0.0):
    return RtpPacket(ssrc, sequence & 0xFFFF, 0, 96, False, b"x", arrived)


def test_a_gap_is_waited_for_and_then_told():
    order = PacketOrder()
    assert order.add(numbered(65_534)) == []
    first = order.add(numbered(65_535))
    assert [(each.sequence, lost) for each, lost in first] == [(65_534, True), (65_535, False)]
    assert order.add(numbered(1, arrived=1.0)) == [] and order.due() == pytest.approx(1.05)
    assert order.expired(1.04) == []
    assert [(each.sequence, lost) for each, lost in order.expired(1.06)] == [(1, True)]
    assert order.add(numbered(0, arrived=1.07)) == []  # too late
    assert order.add(numbered(2, arrived=1.08)) == [(numbered(2, arrived=1.08), False)]


def test_too_many_that_wait_are_not_waited_for():
    order = PacketOrder()
    order.add(numbered(0)), order.add(numbered(1))
    given_up = [order.add(numbered(number)) for number in range(3, 3 + 1025)]
    assert given_up[-1][0] == (numbered(3), True) and len(given_up[-1]) == 1025


def test_what_others_send_is_not_kept():
    order = PacketOrder()
    order.add(numbered(0))
    for number in range(1, 5000):
        at = number / 1000
        assert order.add(numbered(number, arrived=at))
        order.add(numbered(2 * number, ssrc=2, arrived=at))
        order.add(numbered(number, ssrc=number, arrived=at))
    assert len(pickle.dumps(order)) < 100 * len(pickle.dumps(numbered(1)))


def test_a_day_of_time_stamps_does_not_drift():
    """Time stamps of a crystal that is 80 ppm fast wrap each 13 hours; reports come each 5 s."""
    clock, delay, fast = SenderClock(), Delay(), 1 + 80e-6
    first, utc, wrong, late = 4_000_000_000, 1_790_000_000.0, [], []
    for now in range(24 * 3600):
        stamp = round(first + now * fast * RTP_HZ) % 2**32
        if now % 5 == 0:
            clock.report(utc + now, stamp)
        wrong.append(abs(clock.utc(stamp) - (utc + now)))
        late.append(now - delay.undelayed(clock.seconds(stamp), now))
    assert max(wrong) < 5 * 80e-6 + 1e-4 and max(late) < 1e-3
    assert clock.seconds(stamp) == pytest.approx((first / RTP_HZ) + now * fast, abs=1e-3)


def test_what_queued_is_as_old_as_it_is():
    delay = Delay()
    for at in range(100):
        assert delay.undelayed(at / 30, 5.0 + at / 30) == pytest.approx(5 + at / 30, abs=1e-3)
    # The link stops for 2 s, then what queued comes at once.
    ages = [7.0 + 100 / 30 - delay.undelayed(at / 30, 7.0 + 100 / 30) for at in range(100, 160)]
    assert ages[0] == pytest.approx(2.0, abs=0.01)
    assert ages[-1] == pytest.approx(2.0 - 59 / 30, abs=0.01)


def test_a_queue_that_stays_ends_the_session():
    delay = Delay()
    delay.undelayed(0.0, 5.0)
    with pytest.raises(StreamLostError, match=r"2\.0 s late"):
        for at in range(60):
            delay.undelayed(1.0 + at / 30, 8.0 + at / 30)


def test_a_clock_that_is_set_back_is_begun_anew():
    delay = Delay()
    delay.undelayed(1000.0, 5.0)
    assert delay.undelayed(3.0, 5.1) == pytest.approx(5.1)
