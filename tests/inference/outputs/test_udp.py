import json
import math
import socket
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.inference.live import BROADCAST, bound_socket, refuse
from tests.tiers import scaled
from tests.waiting import MAX_S
from tokt.features.common.address import parse_address
from tokt.features.common.errors import ToktError
from tokt.inference.outputs.udp import (
    Receiver,
    UdpSender,
    decode,
    encode_v1,
    encode_v2,
    parse_receiver,
)
from tokt.inference.policy.temporal_cues import TRENDS
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import FIRST, HEALTH_BYTES, V2_FIELDS, Report
from tokt.inference.verdict import Verdict, unknown_verdict

positions = st.integers(-100_000, 100_000)
means = st.floats(0, 255)
DARK = Fault(Reason.DARK, "dark")
any_float = st.floats(allow_nan=True, allow_infinity=True)
any_or_none = st.none() | any_float


def a_verdict(status: int = 1, x: int = -120, y: int = -35, mean: float = 12.3456789012) -> Verdict:
    return Verdict(status, x, y, (1, 2, 3, 4), mean, None, "texture", "m/1")


def parse_v1_by_the_design(datagram: bytes) -> tuple[int, int, int, float]:
    """Written from the format's description alone: eight comma-separated ASCII fields."""
    fields = datagram.decode("ascii").split(",")
    assert len(fields) == 8
    names = [field.strip() for field in fields[0::2]]
    assert names == ["status :", "Xpos :", "Ypos :", "meanValue :"]
    status, x, y, mean = fields[1::2]
    return int(status), int(x), int(y), float(mean)


def test_v1_is_the_design_example_byte_for_byte():
    expected = b"status : , 1  ,Xpos : ,-120,  Ypos : , -35 , meanValue : ,12.3456789012"
    assert encode_v1(a_verdict()) == expected
    nothing = b"status : , 0  ,Xpos : ,0,  Ypos : , 0 , meanValue : ,0"
    assert encode_v1(a_verdict(0, 0, 0, 0.0)) == nothing


@given(st.sampled_from([0, 1]), positions, positions, means)
def test_an_independent_parser_reads_v1_over_a_real_socket(status, x, y, mean):
    with bound_socket() as receiver:
        sender = UdpSender(*receiver.getsockname(), 1)
        sender.send(Report(1, 1, 0.0, 1.0, a_verdict(status, x, y, mean)))
        sender.close()
        data = receiver.recv(4096)
    got = parse_v1_by_the_design(data)
    assert got[:3] == (status, x, y)
    assert got[3] == pytest.approx(mean, rel=1e-11, abs=0)
    assert [*decode(data).values()] == [1, *got]


def test_v1_says_nothing_about_unknown():
    assert encode_v1(unknown_verdict(DARK)) is None
    assert encode_v1(a_verdict(mean=math.nan)) is None
    sender = UdpSender("127.0.0.1", 9, 1)
    sender.send(Report(1, 1, 0.0, 1.0, unknown_verdict(DARK)))
    sender.close()
    assert (sender.sent, sender.failed) == (0, 0)


def test_a_heartbeat_before_the_first_frame_has_no_time():
    silent = unknown_verdict(Fault(Reason.NO_FRAME, "no frame has come yet"))
    fields = decode(encode_v2(Report(1, None, None, None, silent)))
    assert (fields["status"], fields["reason"]) == (-1, "no_frame")
    assert (fields["t"], fields["latency_ms"], fields["age_ms"]) == (None, None, None)


@settings(max_examples=scaled(40))
@given(
    st.builds(
        Verdict,
        status=st.sampled_from([-1, 0, 1]),
        x=st.none() | positions,
        y=st.none() | positions,
        box=st.none() | st.tuples(positions, positions, positions, positions),
        mean=any_or_none,
        distance_m=any_or_none,
        method=st.text(max_size=20),
        model=st.none() | st.text(max_size=50),
        health=st.text(max_size=400),
        reason=st.sampled_from(Reason),
        trend=st.none() | st.sampled_from(TRENDS),
        **dict.fromkeys(
            (
                *("closing_m_s", "contact_s", "trend_confidence", "expansion_contact_s"),
                *("anchor_x", "anchor_y", "anchor_size"),
            ),
            any_or_none,
        ),
    ),
    any_float,
    any_float,
    any_or_none,
)
def test_v2_round_trip_never_holds_what_json_cannot(verdict, t, latency_ms, age_ms):
    data = encode_v2(Report(3, 4, t, latency_ms, verdict, age_ms))
    figures = data.split(b'"method"')[0]
    assert b"NaN" not in figures and b"Infinity" not in figures
    fields = decode(data)
    assert fields["t"] == (t if math.isfinite(t) else None)
    for name, value in (("mean", verdict.mean), ("age_ms", age_ms)):
        assert fields[name] == (value if value is not None and math.isfinite(value) else None)
    assert fields["box"] == (None if verdict.box is None else list(verdict.box))
    assert verdict.health.startswith(fields["health"])
    # A sign beyond 16 bits takes 12 bytes.
    whole = fields["health"] == verdict.health
    assert whole or len(json.dumps(fields["health"])) > HEALTH_BYTES - 12
    assert fields["reason"] == verdict.reason


scalars = any_or_none | st.booleans() | st.integers() | st.integers(0, 10**400)
json_values = st.recursive(
    scalars | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=5,
)
good = json.loads(encode_v2(Report(1, 1, 0.0, 1.0, a_verdict())))


def with_changes(changes: dict[str, Any], overflows: str) -> bytes:
    """A v2 datagram with fields exchanged and added; some JSON for a number beyond all floats."""
    text = json.dumps({**good, **changes})
    return text.replace("Infinity", overflows).encode("utf-8", "surrogatepass")


@settings(max_examples=scaled(50))
@given(
    st.binary(max_size=200)
    | st.builds(
        with_changes,
        st.dictionaries(st.sampled_from(sorted(good)) | st.text(max_size=5), json_values),
        st.sampled_from(["1e999", "Infinity", "NaN"]),
    )
)
def test_any_bytes_are_the_contract_s_finite_fields_or_refused(data):
    try:
        fields = decode(data)
    except ToktError:
        return
    assert list(fields) == (list(good) if fields["v"] == 2 else ["v", "status", "x", "y", "mean"])
    for value in [*fields.values(), *(fields.get("box") or [])]:
        assert not isinstance(value, int | float) or math.isfinite(value)
    json.dumps(fields, allow_nan=False)


@pytest.mark.parametrize("extra", [b"1e999", b"-1e999", b"[[1e999]]", b'{"a": 1e999}'])
def test_what_the_contract_does_not_name_is_left_out(extra):
    data = json.dumps(good).encode()[:-1] + b', "speed": ' + extra + b"}"
    assert decode(data) == good


@pytest.mark.parametrize(
    ("name", "values"),
    {
        "v": [3, 2.0],
        "t": [10**400],
        "box": [[1, 2, 3, 10**400], [1, 2, 3], [1, 2, 3, 4.5]],
        "status": [2, True, None],
        "x": ["left"],
        "health": [None],
        "seq": [1.5],
        "reason": [None, 3],
        "age_ms": ["old", True, 10**400],
        "closing_m_s": ["fast"],
        "trend": [1],
        "trend_confidence": ["high"],
        "expansion_contact_s": [True],
        "anchor_x": [[0.5]],
    }.items(),
)
def test_v2_outside_the_contract_is_refused(name, values):
    decode(json.dumps(good).encode())
    for value in values:
        refuses("not a tokt datagram", decode, json.dumps({**good, name: value}).encode())


@pytest.mark.parametrize("each", V2_FIELDS, ids=[each.name for each in V2_FIELDS])
def test_a_datagram_holds_to_each_row_of_the_table(each):
    def is_read(**change: Any) -> bool:
        fields = {name: value for name, value in {**good, **change}.items() if value is not ...}
        try:
            return decode(json.dumps(fields).encode())[each.name] is None
        except ToktError:
            return False

    assert is_read(**{each.name: None}) == each.nullable
    assert is_read(**{each.name: ...}) == (each.since > FIRST)
    assert not is_read(**{each.name: {}}) and not is_read(**{each.name: True})


@pytest.mark.parametrize(
    "data",
    [
        b'{"a":' * 10_000,
        json.dumps({**good, "mean": math.nan}).encode(),
        b"status : , 1  ,Xpos : ,0,  Ypos : , 0 , meanValue : ,1e+999",
        b"status : , 2  ,Xpos : ,0,  Ypos : , 0 , meanValue : ,1",
        b"status : , 1  ,Xpos : ,0,  Ypos : , 0 , meanValue : ,1\n",
    ],
)
def test_hostile_datagrams_are_refused(data):
    refuses("", decode, data)


def test_a_reason_of_a_newer_sender_is_passed_on():
    fields = decode(json.dumps({**good, "reason": "kraken"}).encode())
    assert fields["reason"] == "kraken"


def test_addresses():
    assert parse_address("192.168.1.73:1130") == ("192.168.1.73", 1130)
    assert parse_address("[::1]:9") == ("::1", 9)
    for text in ("", "host", "host:", ":1", "h:0", "h:65536", "a:b:1", "h:1x"):
        refuses("not an address", parse_address, text)


def test_a_receiver_may_have_a_format_of_its_own():
    assert parse_receiver("10.0.0.1:1130", 1) == Receiver("10.0.0.1", 1130, 1)
    assert parse_receiver("v2@10.0.0.1:1130", 1) == Receiver("10.0.0.1", 1130, 2)
    assert parse_receiver("v1@[::1]:9", 2) == Receiver("::1", 9, 1)
    for text in ("v3@h:1", "@h:1", "v1@@h:1", "V2@h:1"):
        refuses("choose from v1, v2", parse_receiver, text, 1)
    for text in ("v2@", "v2@h", "v2@h:0", "h"):
        refuses("not an address", parse_receiver, text, 1)


def test_receivers_fail_each_for_itself(receiver, closed_port):
    # One the system refuses to send to, one whose host answers "port unreachable" (ICMP), and one
    # that is there: the last gets everything, in order and without delay.
    refused = UdpSender(BROADCAST, 9, 2)
    refuse(refused)
    unreachable = UdpSender("127.0.0.1", closed_port, 2)
    there = UdpSender(*receiver.getsockname(), 2)
    try:
        for seq in range(1, 21):
            for sender in (refused, unreachable, there):
                sender.send(Report(seq, seq, 0.0, 1.0, a_verdict()))
        assert [decode(receiver.recv(4096))["seq"] for _ in range(20)] == list(range(1, 21))
        assert (refused.sent, refused.failed) == (0, 20) and refused.last_error
        assert (unreachable.sent + unreachable.failed, there.sent) == (20, 20)
        assert there.failed == 0
        # Whoever was not there gets what is sent once they are.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
            late.bind(("127.0.0.1", closed_port))
            late.settimeout(MAX_S)
            unreachable.send(Report(21, 21, 0.0, 1.0, a_verdict()))
            assert decode(late.recv(4096))["seq"] == 21
    finally:
        for sender in (refused, unreachable, there):
            sender.close()
