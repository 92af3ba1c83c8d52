"""H.264's frame numbers: whether a picture that others refer to was never sent (clause 7.4.3).

A sender that is short of time leaves pictures out before it numbers its packets, and one that
sends on what another sent may hide that packets were lost. FFmpeg's decoder fills such a gap with
a copy of the picture before it and says nothing.
"""

from collections.abc import Iterable

_SLICES, _KEY, _SETS, _PICTURE_SETS = (1, 5), 5, 7, 8
_HEAD = 64  # bytes of a slice in which its frame number is
_HIGH_PROFILES = frozenset({100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135})


class _Bits:
    """The bits of a NAL unit, after its header."""

    def __init__(self, unit: bytes) -> None:
        raw = unit[1:].replace(b"\0\0\3", b"\0\0")  # emulation prevention
        self._bits = "".join(f"{byte:08b}" for byte in raw)
        self._at = 0

    def take(self, count: int) -> int:
        """An unsigned number of so many bits; IndexError at the end."""
        if (end := self._at + count) > len(self._bits):
            raise IndexError
        value = int(self._bits[self._at : end] or "0", 2)
        self._at = end
        return value

    def golomb(self) -> int:
        """An unsigned Exp-Golomb number (clause 9.1); ValueError or IndexError at the end."""
        zeros = self._bits.index("1", self._at) - self._at
        return self.take(2 * zeros + 1) - 1

    def signed(self) -> int:
        """A signed one."""
        code = self.golomb()
        return (code + 1) // 2 if code % 2 else -(code // 2)


class FrameNumbers:
    """The frame numbers of a stream, one access unit after the other."""

    def __init__(self) -> None:
        self._sets: dict[int, tuple[int, bool, bool]] = {}
        self._set_of: dict[int, int] = {}
        self._last: int | None = None

    def gap(self, units: Iterable[bytes]) -> bool:
        """Whether pictures before these NAL units' one are missing, or its number is unread.

        Asked once for each, in order; one that begins with a key picture is after no gap.
        """
        for unit in units:
            try:
                kind = unit[0] & 31
                if kind == _SETS:
                    self._read_sets(_Bits(unit))
                elif kind == _PICTURE_SETS:
                    bits = _Bits(unit)
                    number = bits.golomb()
                    self._set_of[number] = bits.golomb()
                elif kind in _SLICES:
                    return self._follows(unit, kind)
            except (IndexError, KeyError, ValueError):
                self._last = None
                return True
        return False

    def _read_sets(self, bits: _Bits) -> None:
        """Of a sequence parameter set (clause 7.3.2.1.1) what slices need."""
        profile = bits.take(24) >> 16
        number, separate = bits.golomb(), False
        if profile in _HIGH_PROFILES:
            if (chroma := bits.golomb()) == 3:
                separate = bool(bits.take(1))
            bits.golomb(), bits.golomb(), bits.take(1)
            if bits.take(1):
                _skip_scaling_lists(bits, 12 if chroma == 3 else 8)
        number_bits = bits.golomb() + 4
        if (order := bits.golomb()) == 0:
            bits.golomb()
        elif order == 1:
            bits.take(1), bits.signed(), bits.signed()
            for _ in range(min(bits.golomb(), 255)):
                bits.signed()
        bits.golomb()
        self._sets[number] = number_bits, separate, bool(bits.take(1))

    def _follows(self, unit: bytes, kind: int) -> bool:
        bits = _Bits(unit[:_HEAD])
        bits.golomb(), bits.golomb()
        number_bits, separate, gaps_are_meant = self._sets[self._set_of[bits.golomb()]]
        bits.take(2 if separate else 0)
        number, last = bits.take(number_bits), self._last
        # A picture that none refers to (nal_ref_idc is 0) has the number that the next one has.
        following = number if unit[0] & 0x60 else (number - 1) % (1 << number_bits)
        if kind == _KEY:
            self._last = number
            return False
        self._last = following
        if last is None:
            return True
        return not gaps_are_meant and number not in (last, (last + 1) % (1 << number_bits))


def _skip_scaling_lists(bits: _Bits, lists: int) -> None:
    """Go over them (clause 7.3.2.1.1.1)."""
    for index in range(lists):
        if not bits.take(1):
            continue
        last = following = 8
        for _ in range(16 if index < 6 else 64):
            following = (last + bits.signed()) % 256 if following else 0
            last = following or last
