"""The examples of udp.md and labview.md, and labview.md's tables, held against what is sent.

LabVIEW's *Scan From String* is stood in for by C's `sscanf`, whose format strings are alike where
ours has something: white space, literal characters, `%d` and `%f`. labview.md says where the
two differ.
"""

import ctypes
import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.inference.links.vehicle import VehiclePlace
from tokt.inference.outputs.udp import decode, encode_v1, encode_v2
from tokt.inference.policy.temporal_cues import GROWING, Anchor, wholly_in_view
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import HEALTH_BYTES, Report
from tokt.inference.verdict import Verdict, unknown_verdict

DOCS = Path(__file__).parents[3] / "docs"
UDP, LABVIEW = ((DOCS / name).read_text() for name in ("reference/udp.md", "tutorials/labview.md"))
MAX_SIZE = 8192
"""What docs/tutorials/labview.md has LabVIEW read at most of a v2 datagram."""
ETHERNET = 1472
"""Bytes of a datagram that one Ethernet frame takes: more are sent in pieces."""


def blocks(page: str) -> list[str]:
    return re.findall(r"^```\w*\n(.*?)^```", page, re.MULTILINE | re.DOTALL)


def lines_of(page: str, start: str) -> list[str]:
    return [line for block in blocks(page) for line in block.splitlines() if line.startswith(start)]


def rows(page: str, first: str) -> list[list[str]]:
    """The table under a heading row that begins with `first`."""
    table = page.split(f"\n| {first} |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in table]


def report(verdict: Verdict) -> Report:
    return Report(10**9, 412, 1461149301.3512345, 12.251234567890123, verdict, 1234.1234567890123)


@pytest.mark.parametrize("page", [UDP, LABVIEW], ids=["udp", "labview"])
def test_v1_examples_are_bytes_we_send(page):
    examples = lines_of(page, "status :")
    assert examples
    for example in examples:
        fields = decode(example.encode("ascii"))
        status, x, y, mean = (fields[name] for name in ("status", "x", "y", "mean"))
        again = Verdict(status, x, y, None, mean, None, "texture", None)
        assert encode_v1(again) == example.encode("ascii")


@pytest.mark.parametrize("page", [UDP, LABVIEW], ids=["udp", "labview"])
def test_v2_examples_decode_to_every_key(page):
    examples = lines_of(page, "{")
    assert len(examples) >= 2
    for example in examples:
        fields = decode(example.encode("ascii"))
        assert fields == json.loads(example)
        assert fields["reason"] in set(Reason)
        # Compact, as it is sent.
        assert json.dumps(fields, separators=(",", ":")) == example
    assert {decode(example.encode())["status"] for example in lines_of(UDP, "{")} == {1, 0, -1}


# LabVIEW


def scan_format() -> str:
    (found,) = lines_of(LABVIEW, "%.;")
    return found


def scan(data: bytes) -> tuple[int, tuple[int, int, int, float], bytes]:
    """What `sscanf` makes of a datagram: how many outputs, they, and the remaining string."""
    status, x, y = (ctypes.c_int(default) for default in (-1, 0, 0))
    mean, consumed = ctypes.c_double(math.nan), ctypes.c_int(0)
    format_ = scan_format().removeprefix("%.;").replace("%f", "%lf") + "%n"
    outputs = [ctypes.byref(one) for one in (status, x, y, mean, consumed)]
    count = ctypes.CDLL(None).sscanf(data, format_.encode("ascii"), *outputs)
    values = (status.value, x.value, y.value, mean.value)
    return count, values, data[consumed.value :]


@given(
    st.sampled_from([0, 1]),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(-(2**31), 2**31 - 1),
    st.floats(0, 255),
)
def test_the_format_string_reads_every_v1_datagram(status, x, y, mean):
    data = encode_v1(Verdict(status, x, y, None, mean, None, "texture", None))
    assert data is not None and len(data) <= 120
    assert scan(data) == (4, (status, x, y, float(f"{mean:.12g}")), b"")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"garbage",
        b'{"v":2,"seq":1,"status":0}',
        b"status : , clear  ,Xpos : ,0,  Ypos : , 0 , meanValue : ,0",
        b"Xpos : ,0,  Ypos : , 0 , meanValue : ,0",
    ],
)
def test_what_does_not_fit_leaves_status_unknown(data):
    count, values, _ = scan(data)
    assert count < 4 and values[0] == -1


@pytest.mark.parametrize("cut", range(1, 71))
def test_a_cut_datagram_is_noticed_or_has_lost_digits_of_the_mean_only(cut):
    (example,) = {line for line in lines_of(LABVIEW, "status :")}
    count, values, _ = scan(example.encode()[:-cut])
    # The mean has no mark at its end; status, Xpos and Ypos are whole wherever it was reached.
    assert count < 4 or values[:3] == (1, -120, -35)


def unflattened(data: bytes) -> dict[str, Any]:
    """*Unflatten From JSON* as its help describes it, with the cluster of labview.md.

    *default null elements* TRUE, *strict validation* FALSE; an element of another type, or one
    that the JSON does not have, is an error.
    """
    types = {"I32": int, "I64": int, "DBL": (int, float), "string": str, "array of I32": list}
    given_, cluster = json.loads(data), {}
    for label, type_, default in rows(LABVIEW, "label"):
        value = given_[label]
        if value is None:
            value = {"NaN": math.nan, "empty": [] if "array" in type_ else ""}.get(default)
            cluster[label] = int(default) if value is None else value
            continue
        assert isinstance(value, types[type_]) and not isinstance(value, bool), label
        if type_ == "I32":
            assert -(2**31) <= value < 2**31
        cluster[label] = value
    return cluster


def test_the_cluster_has_the_keys_of_a_datagram():
    sent = list(report(unknown_verdict(Fault(Reason.DARK, "dark"))).fields())
    for varies in ("classes", "sight"):  # in their keys: no cluster has them, and none needs it
        sent.remove(varies)
    assert [row[0] for row in rows(LABVIEW, "label")] == sent


def test_the_cluster_takes_the_examples_and_null_is_never_clear():
    obstacle, heartbeat = (unflattened(line.encode()) for line in lines_of(LABVIEW, "{"))
    assert (obstacle["status"], obstacle["x"], obstacle["distance_m"]) == (1, -120, 4.63)
    assert obstacle["box"] == [264, 130, 72, 81] and obstacle["model"] == ""
    assert heartbeat["status"] == -1 and math.isnan(heartbeat["distance_m"])
    assert heartbeat["box"] == [] and heartbeat["reason"] == "stale"
    defaults = {row[0]: row[2] for row in rows(LABVIEW, "label")}
    assert defaults["status"] == "-1" and defaults["distance_m"] == "NaN"


def test_the_elements_said_never_to_be_null_are_none():
    said = re.search(r"((?:`\w+`(?:, | and ))+`\w+`) are never\s+null", LABVIEW)
    names = re.findall(r"\w+", said[1].replace(" and ", " "))
    assert names == ["status", "v", "seq", "method", "health", "reason"]
    heartbeat = unknown_verdict(Fault(Reason.NO_FRAME, "no frame has come yet"))
    for one in (Report(1, None, None, None, heartbeat), report(heartbeat)):
        assert all(one.fields()[name] is not None for name in names)


def test_no_v2_datagram_is_larger_than_labview_reads():
    assert f"wire {MAX_SIZE}" in LABVIEW
    far = -1.2345678901234567e-300
    for letter in ("a", '"', "\x07", "\U0001f40b"):  # the last is two escapes of six characters
        words, name = letter * 400, letter * 100
        verdict = Verdict(
            *(1, -99999, -99999, (99999, 99999, 99999, 99999), far),
            *(far, "texture+disparity+pushbroom", f"{name}/{name}", words),
            *(far, far, Reason.DETECTOR_FAILED, None, "shrinking"),
            *(0.999, far, -0.999, -0.999, -9.999),  # these have three decimals
            anchor="searching",
        )
        place = VehiclePlace(-9999.99, 359.9, -89.1234567, -179.1234567, 1234.5)
        data = encode_v2(Report(10**15, 412, far, far, verdict, far, place=place))
        assert len(data) <= ETHERNET < MAX_SIZE
        health = decode(data)["health"]
        assert words.startswith(health) and len(health) >= HEALTH_BYTES // 12
        assert letter != "a" or len(health) == HEALTH_BYTES


@pytest.mark.parametrize("page", [UDP, LABVIEW], ids=["udp", "labview"])
def test_the_example_s_anchor_is_what_its_box_and_mean_come_to(page):
    (example,) = (decode(line.encode()) for line in lines_of(page, "{") if '"status":1' in line)
    verdict = Verdict(
        *(1, example["x"], example["y"], tuple(example["box"]), example["mean"], None),
        *("disparity", None),
        mask_size=(271, 360),
    )
    names = ("anchor_x", "anchor_y", "anchor_size")
    assert tuple(example[name] for name in names) == Anchor(0.1).errors(verdict)
    assert example["trend"] == GROWING and wholly_in_view(verdict)


def test_the_reference_decoder_of_the_page_works():
    (program,) = (block for block in blocks(LABVIEW) if block.startswith("from tokt"))
    found: dict[str, Any] = {}
    exec(program.replace("\ndecode(", "\nfields = decode("), found)
    assert found["fields"]["status"] == 1
    refuses("", decode, b"")
