"""Quantization of a 16-bit gray picture to the grey levels that textures are counted in.

A faint obstacle lies within one grey level of the water around it, under a fall of light of tens
of levels. So the picture is kept in 16 bits (1/256 grey level), what lies around each pixel is
taken away, and what is left is spread over the levels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tokt.features.common.errors import ToktError

STEPS_PER_LEVEL = 256
"""Steps of a 16-bit gray picture in one grey level."""

BGR_WEIGHTS = (1868, 9617, 4899)
"""ITU-R BT.601 in parts of 2**14, as OpenCV has them."""
WHOLE_WEIGHT = sum(BGR_WEIGHTS)

MAX_PIXELS_AROUND = 255
"""Largest side of a box whose sum of 16-bit pixels fits 32 bits."""

DIFFERENCE, RATIO, FRAME = "difference", "ratio", "frame"
_WAYS = (DIFFERENCE, RATIO, FRAME)
RATIO_OF = 32.0
"""A ratio to the surroundings is that to surroundings of this many grey levels."""
MIN_AROUND = 4.0
"""Grey levels: darker surroundings count as these, or noise in the dark would be a large ratio."""
FRAME_OF = 20.0
"""A difference in relation to the whole frame is that in a frame of this mean grey level."""
MIN_FRAME = 1.0
"""Grey levels: the mean of a darker frame counts as this."""

_BASE = {"resize": "area_deep", "gray": "bt601"}
_KEYS = {*_BASE, "smooth", "flatten", "gain", "levels"}
_MIN_LEVELS, _MAX_LEVELS = 8, 256
_MAX_GAIN = 1024.0


def gray16_step(shape: tuple[int, ...]) -> float:
    """The factor from the whole number summed for a pixel to 1/256 grey levels."""
    return 256.0 / (WHOLE_WEIGHT * shape[0] * shape[1])


@dataclass(frozen=True)
class Quantization:
    """A spec's ``image`` that is not the plain one.

    A pixel's level is ``floor(x * gain * levels / 256 + middle + 1/2)``, at least 0 and at most
    levels - 1. With s the mean of the ``smooth`` x ``smooth`` pixels around it and b that of
    ``window`` x ``window``, both over the part inside the picture (a whole sum, times one by its
    columns, times one by its rows), in grey levels:

    - flattened by difference: x = s - b; by ratio: x = 32 (s - b) / max(b, 4); by frame, with m the
      mean of the whole picture: x = 20 (s - b) / max(m, 1); middle = levels / 2;
    - not flattened: x = s; middle = 0.

    Parameters
    ----------
    gain : float
        How many levels of 256 a grey level becomes.
    levels : int
        Number of levels, 8 to 256.
    smooth : int
        Pixels, odd; 1 leaves the picture as it is.
    window : int
        Pixels, odd; 0 for a picture that is not flattened.
    by : {"difference", "ratio", "frame"}
    """

    gain: float
    levels: int = 256
    smooth: int = 1
    window: int = 0
    by: str = DIFFERENCE

    def scale(self, total: int, pixels: int) -> float:
        """Levels that one step of a 16-bit gray picture (or of its ratio) becomes.

        Parameters
        ----------
        total, pixels : int
            The picture's sum of steps, and its size.
        """
        scale = self.gain * self.levels / (256.0 * STEPS_PER_LEVEL)
        if self.window and self.by == FRAME:
            scale *= FRAME_OF * STEPS_PER_LEVEL / max(total / pixels, MIN_FRAME * STEPS_PER_LEVEL)
        return scale

    @property
    def offset(self) -> float:
        """The level added before rounding down: one half, and the middle level if flattened."""
        return (self.levels / 2.0 if self.window else 0.0) + 0.5

    @property
    def label(self) -> str:
        """A few letters for the names of features."""
        parts = [f"flat{self.window}_{self.by}"] if self.window else ["deep"]
        if self.smooth > 1:
            parts.append(f"smooth{self.smooth}")
        return "_".join([*parts, f"gain{self.gain}", f"levels{self.levels}"])

    def to_json(self) -> dict[str, Any]:
        """The image object of a spec."""
        flatten = {"window": self.window, "by": self.by} if self.window else None
        return {
            **_BASE,
            "smooth": self.smooth,
            "flatten": flatten,
            "gain": self.gain,
            "levels": self.levels,
        }

    @classmethod
    def from_json(cls, value: Any) -> Quantization:
        """Read what `to_json` wrote; ToktError for anything else, or an option out of range."""
        if not isinstance(value, Mapping) or any(value.get(key) != _BASE[key] for key in _BASE):
            raise ToktError(f"image {value!r} is not known here")
        _check_keys(value, _KEYS, "image")
        gain, levels = value["gain"], value["levels"]
        if type(gain) not in (int, float) or not 0 < gain <= _MAX_GAIN:
            raise ToktError(f"image: gain is above 0 and at most {_MAX_GAIN:g}, not {gain!r}")
        if type(levels) is not int or not _MIN_LEVELS <= levels <= _MAX_LEVELS:
            raise ToktError(
                f"image: levels is a whole number, {_MIN_LEVELS} to {_MAX_LEVELS}, not {levels!r}"
            )
        smooth = _odd(value["smooth"], 1, "smooth")
        flatten = value["flatten"]
        if flatten is None:
            return cls(gain, levels, smooth)
        if not isinstance(flatten, Mapping):
            raise ToktError("image: flatten is null or an object of window and by")
        _check_keys(flatten, {"window", "by"}, "image: flatten")
        if flatten["by"] not in _WAYS:
            raise ToktError(f"image: flatten is by {', '.join(_WAYS)}, not {flatten['by']!r}")
        return cls(gain, levels, smooth, _odd(flatten["window"], 3, "window"), flatten["by"])


def _check_keys(value: Mapping[str, Any], keys: set[str], what: str) -> None:
    if set(value) != keys:
        wrong = ", ".join(sorted(map(str, set(value) ^ keys)))
        raise ToktError(f"{what}: unknown or missing in its spec: {wrong}")


def _odd(value: Any, least: int, name: str) -> int:
    if type(value) is not int or not least <= value <= MAX_PIXELS_AROUND or value % 2 == 0:
        raise ToktError(
            f"image: {name} is an odd number of pixels, {least} to {MAX_PIXELS_AROUND}, "
            f"not {value!r}"
        )
    return value
