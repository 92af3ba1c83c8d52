"""Datagrams: UDP v1 for the thesis's LabVIEW program, UDP v2 (JSON), and sending either.

Both formats are fixed in udp.md. Unknown is never sent as clear: v1 has no word for it and
sends nothing, so that LabVIEW's receive time-out acts; v2 sends status -1.
"""

import json
import math
import re
from typing import Any, NamedTuple

from tokt.features.common.address import parse_address
from tokt.features.common.errors import ToktError
from tokt.inference.links.datagrams import DatagramSocket
from tokt.inference.report import DATAGRAM_BYTES, FIRST, V1_FIELDS, V2, V2_FIELDS, Report
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, Verdict

DEFAULT_RECEIVER = "127.0.0.1:1130"
"""The port of the thesis's LabVIEW program."""

_V1 = re.compile(
    rb"status : , ([01])  ,Xpos : ,(-?\d{1,9}),  Ypos : , (-?\d{1,9}) , meanValue : ,"
    rb"(\d{1,24}(?:\.\d{1,24})?(?:e[+-]\d{1,3})?)"
)
FORMATS = {"v1": 1, "v2": 2}
"""The formats by the names they have on the command line."""


def encode_v1(verdict: Verdict) -> bytes | None:
    """One ASCII datagram of eight comma-separated fields.

    None for what v1 cannot say: an unknown verdict, or a mean that is not finite.
    """
    if verdict.status not in (OBSTACLE, CLEAR) or verdict.x is None or verdict.y is None:
        return None
    if verdict.mean is None or not math.isfinite(verdict.mean):
        return None
    return (
        f"status : , {verdict.status}  ,Xpos : ,{verdict.x},  Ypos : , {verdict.y} "
        f", meanValue : ,{verdict.mean:.12g}"
    ).encode("ascii")


def encode_v2(report: Report) -> bytes:
    """One JSON object in ASCII, every field of v2 present; at most `DATAGRAM_BYTES`."""
    fields = report.fields()
    data = _compact(fields)
    return data if len(data) <= DATAGRAM_BYTES else _compact({**fields, "classes": None})


def _compact(fields: dict[str, Any]) -> bytes:
    return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode("ascii")


def decode(data: bytes) -> dict[str, Any]:
    """Read a datagram of either format; ToktError if it is neither.

    For v1 ``{"v": 1, "status", "x", "y", "mean"}``; for v2 exactly the fields of `Report.fields`,
    whatever else it holds, None for what an older sender does not know. Every number is finite.
    """
    match = _V1.fullmatch(data)
    if match is not None:
        pairs = zip(V1_FIELDS, match.groups(), strict=True)
        fields = {each.name: each.kind(text) for each, text in pairs}
        if not all(map(math.isfinite, fields.values())):
            raise ToktError("not a tokt datagram: v1 with a mean value that is not finite")
        return {"v": 1, **fields}
    try:
        value = json.loads(data.decode("utf-8"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise ToktError("not a tokt datagram: neither v1 nor JSON") from None
    return _contract_fields(value)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _contract_fields(value: Any) -> dict[str, Any]:
    """Hold a JSON value against the contract of v2; only what the contract names is passed on."""
    if not isinstance(value, dict) or type(value.get("v")) is not int or value["v"] != V2:
        raise ToktError("not a tokt datagram: JSON, but not version 2")
    for each in V2_FIELDS:
        # What was added later is not in the datagrams of older senders.
        empty = each.nullable if each.name in value else each.since > FIRST
        field = value.get(each.name)
        if not (empty if field is None else each.fits(field)):
            raise ToktError(f"not a tokt datagram: v2 with a wrong or missing {each.name!r}")
    if value["status"] not in (OBSTACLE, CLEAR, UNKNOWN):
        raise ToktError(f"not a tokt datagram: status {value['status']}")
    return {each.name: value.get(each.name) for each in V2_FIELDS}


class Receiver(NamedTuple):
    """Where datagrams go, and in which format."""

    host: str
    port: int
    version: int


def parse_receiver(text: str, version: int) -> Receiver:
    """Read ``HOST:PORT``, or ``v1@HOST:PORT`` of a format of its own; ToktError if it is none."""
    format_, at, address = text.rpartition("@")
    if at:
        version = version_of(format_)
    return Receiver(*parse_address(address), version)


def version_of(format_: str) -> int:
    """The version that a format's name, such as ``v2``, stands for; ToktError if it is none."""
    if format_.strip() not in FORMATS:
        raise ToktError(f"unknown format {format_!r} (choose from {', '.join(FORMATS)})")
    return FORMATS[format_.strip()]


class UdpSender(DatagramSocket):
    """Send every report to one address, as v1 or v2; ToktError as of `DatagramSocket`."""

    def __init__(self, host: str, port: int, version: int) -> None:
        super().__init__(host, port)
        self.version = version

    def send(self, report: Report) -> None:
        """Send one datagram, or count why not; of what the format cannot say, none."""
        data = encode_v1(report.verdict) if self.version == 1 else encode_v2(report)
        if data is not None:
            self.write(data)
