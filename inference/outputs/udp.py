"""Datagrams: UDP v1 for the thesis's LabVIEW program, UDP v2 (JSON), and sending either.

Both formats are fixed in docs/udp.md. Unknown is never sent as clear: v1 has no word for it and
sends nothing, so that LabVIEW's receive time-out acts; v2 sends status -1.
"""

import ipaddress
import json
import math
import re
import socket
import sys
from typing import Any, NamedTuple

from tokt.features.common.address import parse_address, resolve
from tokt.features.common.errors import ToktError, os_words
from tokt.inference.report import FIRST, V1_FIELDS, V2, V2_FIELDS, Report
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, Verdict

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 1130
"""The port of the thesis's LabVIEW program."""

_V1 = re.compile(
    rb"status : , ([01])  ,Xpos : ,(-?\d{1,9}),  Ypos : , (-?\d{1,9}) , meanValue : ,"
    rb"(\d{1,24}(?:\.\d{1,24})?(?:e[+-]\d{1,3})?)"
)
FORMATS = {"v1": 1, "v2": 2}
"""The formats by the names they have on the command line."""


def encode_v1(verdict: Verdict) -> bytes | None:
    """One ASCII datagram of eight comma-separated fields, or None for what v1 cannot say.

    Returns
    -------
    bytes or None
        None for an unknown verdict, and for a mean that is not finite.
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
    """One JSON object in ASCII, every field of v2 present."""
    return json.dumps(report.fields(), separators=(",", ":"), allow_nan=False).encode("ascii")


def decode(data: bytes) -> dict[str, Any]:
    """Read a datagram of either format.

    Returns
    -------
    dict
        For v1 ``{"v": 1, "status", "x", "y", "mean"}``; for v2 exactly the fields of
        `Report.fields`, whatever else its JSON object holds; what an older sender does not know
        yet is None. Every number is finite.

    Raises
    ------
    ToktError
        If it is neither.
    """
    match = _V1.fullmatch(data)
    if match is not None:
        values = [each.kind(text) for each, text in zip(V1_FIELDS, match.groups(), strict=True)]
        if not all(map(math.isfinite, values)):
            raise ToktError("not a tokt datagram: v1 with a mean value that is not finite")
        return {"v": 1, **{each.name: value for each, value in zip(V1_FIELDS, values, strict=True)}}
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
        kinds = (int, float) if each.kind is float else (each.kind,)
        # What was added later is not in the datagrams of older senders.
        late = each.since > FIRST and each.name not in value
        if not (late or _fits(value.get(each.name), kinds, each.nullable and each.name in value)):
            raise ToktError(f"not a tokt datagram: v2 with a wrong or missing {each.name!r}")
    if value["status"] not in (OBSTACLE, CLEAR, UNKNOWN):
        raise ToktError(f"not a tokt datagram: status {value['status']}")
    return {each.name: value.get(each.name) for each in V2_FIELDS}


def _fits(field: Any, types: tuple[type, ...], optional: bool) -> bool:
    if field is None:
        return optional
    if isinstance(field, bool) or not isinstance(field, types):
        return False
    if isinstance(field, list):
        return len(field) == 4 and all(_fits(part, (int,), False) for part in field)
    if isinstance(field, int | float):
        # Neither NaN, nor infinite (1e999 is, to a JSON parser), nor whole but beyond any float.
        return abs(field) <= sys.float_info.max
    return True


class Receiver(NamedTuple):
    """Where datagrams go, and in which format."""

    host: str
    port: int
    version: int


def parse_receiver(text: str, version: int) -> Receiver:
    """Read ``HOST:PORT``, or ``v1@HOST:PORT`` where a receiver has a format of its own.

    Parameters
    ----------
    text : str
    version : {1, 2}
        The format of a receiver that names none.

    Raises
    ------
    ToktError
        If the address or the format is none.
    """
    format_, at, address = text.rpartition("@")
    if at:
        version = version_of(format_)
    return Receiver(*parse_address(address), version)


def version_of(format_: str) -> int:
    """The version that a format's name, such as ``v2``, stands for.

    Raises
    ------
    ToktError
        If there is no such format.
    """
    if format_.strip() not in FORMATS:
        raise ToktError(f"unknown format {format_!r} (choose from {', '.join(FORMATS)})")
    return FORMATS[format_.strip()]


class DatagramSocket:
    """A socket for datagrams to one address, which never waits for the network.

    It does not block and is not connected: an unreachable host, a cable that is out or a receiver
    that is not running costs one failed call at most, and sending works again by itself when the
    network does. What one receiver's network does touches no other's socket.

    Parameters
    ----------
    host : str
        Name or address. A name is looked up once, here: a look-up can take seconds, which no loop
        that keeps a pilot informed has. A receiver whose address changes needs a new start.
    port : int

    Attributes
    ----------
    sent : int
        Datagrams the operating system took. UDP does not tell whether anyone listens.
    failed : int
        Datagrams it refused (no route, full buffer, ...).
    last_error : str
        Why the last refused datagram was refused.

    Raises
    ------
    ToktError
        If the host name is not known, or is none that can be sent to.
    """

    def __init__(self, host: str, port: int) -> None:
        self.sent = 0
        self.failed = 0
        self.last_error = ""
        family, self._address = resolve(host, port)
        receiver = ipaddress.ip_address(self._address[0])
        if receiver.is_unspecified:
            raise ToktError(f"{host} is an address to listen on: name the receiver's own")
        if family is socket.AF_INET6 and receiver.is_link_local and not self._address[3]:
            raise ToktError(f"{host} is on no network yet: add its name, such as [{host}%eth0]")
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        if family is socket.AF_INET:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.setblocking(False)

    def write(self, data: bytes) -> None:
        """Send one datagram, or count why not."""
        try:
            self._socket.sendto(data, self._address)
        except OSError as error:
            self.failed += 1
            self.last_error = os_words(error)
        else:
            self.sent += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class UdpSender(DatagramSocket):
    """Send every report to one address, in one of the formats.

    Parameters
    ----------
    host, port
        As of `DatagramSocket`.
    version : {1, 2}

    Raises
    ------
    ToktError
        If the host name is not known.
    """

    def __init__(self, host: str, port: int, version: int) -> None:
        super().__init__(host, port)
        self.version = version

    def send(self, report: Report) -> None:
        """Send one datagram, or count why not; of what the format cannot say, none."""
        data = encode_v1(report.verdict) if self.version == 1 else encode_v2(report)
        if data is not None:
            self.write(data)
