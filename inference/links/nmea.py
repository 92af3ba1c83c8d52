"""NMEA 0183: the vehicle's place by sentences; mavlink.md says which is taken for what."""

import re
from collections.abc import Iterator
from functools import reduce
from operator import xor

from .vehicle import VehicleState

MAX_LINE = 200
"""Bytes of a line, of which NMEA allows 82."""
_SENTENCE = re.compile(rb"\$(([A-Z0-9]{3,8}),([ -)+-~]*))\*([0-9A-Fa-f]{2})\s*")
_NUMBER = re.compile(r"[+-]?\d{1,9}(?:\.\d{0,9})?")
_ANGLE = re.compile(r"(\d{2,3})([0-5]\d(?:\.\d{0,9})?)")
_SIGNS = {"N": 1.0, "E": 1.0, "S": -1.0, "W": -1.0}
_POSITIONS = {
    "GGA": (1, 5, "123456"),  # neither without a fix, nor entered by hand, nor simulated
    "RMC": (2, 1, "A"),
    "GLL": (0, 5, "A"),
}
"""Where the latitude stands, where its quality does, and the good ones."""


def _number(text: str) -> float:
    if _NUMBER.fullmatch(text) is None:
        raise ValueError(text)
    return float(text)


def _angle(text: str, side: str) -> float:
    """Degrees of ``DDMM.MMM`` and N, S, E or W."""
    match = _ANGLE.fullmatch(text)
    if match is None:
        raise ValueError(text)
    return _SIGNS[side] * (int(match[1]) + float(match[2]) / 60)


def _figures(kind: str, fields: list[str]) -> Iterator[tuple[int, dict[str, float]]]:
    """Rank and figures of a sentence; ValueError, IndexError or KeyError if it is not whole."""
    if kind in _POSITIONS:
        at, quality, good = _POSITIONS[kind]
        if fields[quality] and fields[quality] in good:
            lat_deg, lon_deg = (_angle(*fields[n : n + 2]) for n in (at, at + 2))
            yield 0, {"lat_deg": lat_deg, "lon_deg": lon_deg}
    elif kind == "HDT":
        yield 0, {"heading_deg": _number(fields[0])}
    elif kind in ("HDG", "HDM"):  # a compass's, with deviation and variation as far as it has them
        turns = [fields[1:3], fields[3:5]] if kind == "HDG" else []
        turn = sum(_SIGNS[side] * _number(value) for value, side in turns if value)
        yield 1, {"heading_deg": (_number(fields[0]) + turn) % 360}
    elif kind == "PRDID":
        pitch_deg, roll_deg, heading_deg = map(_number, fields[:3])
        yield 0, {"pitch_deg": pitch_deg, "roll_deg": roll_deg}
        yield 0, {"heading_deg": heading_deg}
    elif kind == "DPT":
        yield 0, {"depth_m": _number(fields[0])}
    elif kind == "XDR":
        for what, value, unit, name in zip(*(fields[n::4] for n in range(4)), strict=False):
            if (what, unit) == ("D", "M") and "DEPTH" in name.upper():
                yield 0, {"depth_m": _number(value)}


class NmeaReader:
    """Read sentences; one without its checksum, or not whole, is passed over.

    `dpt` tells that DPT says the vehicle's depth, and not the water's below it; `whole`, that what
    comes are datagrams, which end a line.
    """

    def __init__(self, vehicle: VehicleState, dpt: bool, whole: bool) -> None:
        self._vehicle, self._dpt, self._whole = vehicle, dpt, whole
        self._rest = b""

    def heard(self, data: bytes, sender: str = "") -> bool:
        """Take a piece in; whether a sentence ended in it."""
        *lines, self._rest = (self._rest + data + b"\n" * self._whole).split(b"\n")
        if len(self._rest) > MAX_LINE:
            self._rest = b""
        return any([self._line(line, sender) for line in lines if len(line) <= MAX_LINE])

    def _line(self, line: bytes, sender: str) -> bool:
        match = _SENTENCE.fullmatch(line)
        if match is None or reduce(xor, match[1]) != int(match[4], 16):
            return False
        name, fields = match[2].decode(), match[3].decode().split(",")
        kind = name if name == "PRDID" else name[-3:]  # without who talks
        try:
            for rank, figures in _figures(kind, fields) if kind != "DPT" or self._dpt else ():
                self._vehicle.put(rank, sender, **figures)
        except (ValueError, IndexError, KeyError, TypeError):
            return False
        return True
