"""Extractors: a frame and a grid become one feature row a patch, as a JSON spec says.

Training and the runtime both call `Extractor.describe`, so they cannot differ. A spec is all
there is to know about an extractor; two equal specs give equal features.

Specs, version 1::

    {"name": "lbp", "version": 1, "points": 10, "radius": 5, "border": "patch", "image": {...}}
    {"name": "haralick", "version": 1, "ignore_zeros": false, "image": {...}}
    {"name": "join", "version": 1, "parts": [SPEC, SPEC, ...]}

``image`` says how the frame becomes the gray picture that is looked at; there is one way so far:
``{"resize": "area", "gray": "bt601"}``, INTER_AREA to the grid's width, then BGR to gray.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .checks import check_frame
from .errors import ToktError
from .grid import Grid
from .kernels import KERNELS

Spec = Mapping[str, Any]
SPEC_VERSION = 1
PLAIN_IMAGE = {"resize": "area", "gray": "bt601"}
_LARGEST_PICTURE = 100_000_000  # pixels; a thinner strip than any camera's would become more
HARALICK_NAMES = (
    "angular_second_moment",
    "contrast",
    "correlation",
    "sum_of_squares",
    "inverse_difference_moment",
    "sum_average",
    "sum_variance",
    "sum_entropy",
    "entropy",
    "difference_variance",
    "difference_entropy",
    "information_correlation_1",
    "information_correlation_2",
)


class Extractor(Protocol):
    """What turns a frame into features."""

    @property
    def spec(self) -> dict[str, Any]:
        """The JSON spec that describes this extractor whole."""

    @property
    def names(self) -> tuple[str, ...]:
        """One name a feature."""

    @property
    def dim(self) -> int:
        """Number of features of one patch."""

    def describe(
        self,
        frame: NDArray[np.uint8],
        grid: Grid,
        gray: NDArray[np.uint8] | None = None,
        threads: int = 1,
    ) -> NDArray[np.float64]:
        """Features of every patch: float64, shape (grid.n_patches, dim), row by row.

        Parameters
        ----------
        frame : array of uint8, shape (height, width) or (height, width, 3)
            As the camera gave it, gray or BGR, any size.
        grid : Grid
        gray : array of uint8, shape (height, width), optional
            ``gray_picture(frame, grid)``, where the caller has it already.
        threads : int
            How many threads share the rows of patches; the result does not depend on it.
        """


def gray_picture(frame: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.uint8]:
    """The frame as the plain extractors see it: resized to the grid's width, then gray.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
        As the camera gave it, gray or BGR, any size.
    grid : Grid
        Says the width.
    threads : int
        How many threads share the work.

    Raises
    ------
    TypeError, ValueError
        If the frame is not uint8, or has another shape.
    """
    frame = check_frame(frame, threads)
    height, width = grid.resized(*frame.shape[:2])
    if not 1 <= height * width <= _LARGEST_PICTURE:
        raise ValueError(f"a frame of {frame.shape} becomes {width}x{height} pixels in grid {grid}")
    return KERNELS.resized_gray(frame, height, width, threads)


class _OfGray(ABC):
    """An extractor that sees a frame as its `gray_picture`."""

    def describe(
        self,
        frame: NDArray[np.uint8],
        grid: Grid,
        gray: NDArray[np.uint8] | None = None,
        threads: int = 1,
    ) -> NDArray[np.float64]:
        """Features of every patch; see `Extractor.describe`."""
        picture = gray_picture(frame, grid, threads) if gray is None else gray
        return self.describe_picture(picture, grid, threads)

    @abstractmethod
    def describe_picture(
        self, gray: NDArray[np.uint8], grid: Grid, threads: int
    ) -> NDArray[np.float64]:
        """`describe` for a frame that is resized and gray already."""


class Lbp(_OfGray):
    """Normalised histograms of uniform local binary patterns (thesis section 3.4)."""

    def __init__(self, points: int, radius: int, border: str) -> None:
        self.points = points
        self.radius = radius
        self.border = border
        self.names = tuple(
            f"lbp_{points}_{radius}_{border}_{pattern}" for pattern in [*range(points + 1), "other"]
        )
        self.dim = points + 2

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        return {
            "name": "lbp",
            "version": SPEC_VERSION,
            "points": self.points,
            "radius": self.radius,
            "border": self.border,
            "image": dict(PLAIN_IMAGE),
        }

    def describe_picture(
        self, gray: NDArray[np.uint8], grid: Grid, threads: int
    ) -> NDArray[np.float64]:
        """Fraction of a patch's pixels with each pattern; rows sum to 1."""
        counts = KERNELS.lbp_counts(gray, grid, self.points, self.radius, self.border, threads)
        patch_height, patch_width = grid.patch_size(*gray.shape)
        return counts / float(patch_height * patch_width)


class Haralick(_OfGray):
    """Haralick's first 13 features, mean over 4 directions (thesis section 3.5)."""

    def __init__(self, ignore_zeros: bool) -> None:
        self.ignore_zeros = ignore_zeros
        self.names = tuple(f"haralick_{name}" for name in HARALICK_NAMES)
        self.dim = len(self.names)

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        return {
            "name": "haralick",
            "version": SPEC_VERSION,
            "ignore_zeros": self.ignore_zeros,
            "image": dict(PLAIN_IMAGE),
        }

    def describe_picture(
        self, gray: NDArray[np.uint8], grid: Grid, threads: int
    ) -> NDArray[np.float64]:
        """The 13 features of each patch's grey-level co-occurrence matrices (GLCM)."""
        return KERNELS.haralick_features(gray, grid, self.ignore_zeros, threads)


class Join(_OfGray):
    """Several extractors' features side by side, from one gray picture."""

    def __init__(self, parts: Sequence[Lbp | Haralick]) -> None:
        self.parts = tuple(parts)
        self.dim = sum(part.dim for part in self.parts)

    @property
    def names(self) -> tuple[str, ...]:
        """The parts' names, in order."""
        return tuple(name for part in self.parts for name in part.names)

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        parts = [part.spec for part in self.parts]
        return {"name": "join", "version": SPEC_VERSION, "parts": parts}

    def describe_picture(
        self, gray: NDArray[np.uint8], grid: Grid, threads: int
    ) -> NDArray[np.float64]:
        """The parts' features, in order."""
        return np.hstack([part.describe_picture(gray, grid, threads) for part in self.parts])


def _lbp_from(spec: Spec) -> Lbp:
    points, radius, border = spec["points"], spec["radius"], spec["border"]
    if type(points) is not int or type(radius) is not int:
        raise ToktError(f"lbp: points and radius are whole numbers, not {points!r}, {radius!r}")
    if not 4 <= points <= 64 or not 1 <= radius <= 32:
        raise ToktError(f"lbp: {points} points at radius {radius} is out of range (4-64, 1-32)")
    if border not in ("patch", "frame"):
        raise ToktError(f"lbp: border is 'patch' or 'frame', not {border!r}")
    return Lbp(points, radius, border)


def _haralick_from(spec: Spec) -> Haralick:
    if type(spec["ignore_zeros"]) is not bool:
        raise ToktError("haralick: ignore_zeros is true or false")
    return Haralick(spec["ignore_zeros"])


_BUILDERS: dict[str, tuple[Callable[[Spec], Lbp | Haralick], set[str]]] = {
    "lbp": (_lbp_from, {"name", "version", "points", "radius", "border", "image"}),
    "haralick": (_haralick_from, {"name", "version", "ignore_zeros", "image"}),
}


def _check_head(spec: Any) -> str:
    """The name in a spec, once that and the version are known ones."""
    if not isinstance(spec, Mapping):
        raise ToktError(f"an extractor's spec is an object, not {type(spec).__name__}")
    name, version = spec.get("name"), spec.get("version")
    if name not in (*_BUILDERS, "join"):
        raise ToktError(f"unknown extractor {name!r} (known: {', '.join([*_BUILDERS, 'join'])})")
    if type(version) is not int or version != SPEC_VERSION:
        raise ToktError(f"extractor {name}: version {version!r} is not known here")
    return str(name)


def _check_keys(spec: Spec, keys: set[str]) -> None:
    if set(spec) != keys:
        wrong = ", ".join(sorted(map(str, set(spec) ^ keys)))
        raise ToktError(f"extractor {spec['name']}: unknown or missing in its spec: {wrong}")


def _plain_from(spec: Any) -> Lbp | Haralick:
    """Build what a spec describes, unless it is a join."""
    name = _check_head(spec)
    if name == "join":
        raise ToktError("extractor join: takes two or more plain extractors")
    builder, keys = _BUILDERS[name]
    _check_keys(spec, keys)
    if spec["image"] != PLAIN_IMAGE:
        raise ToktError(f"extractor {name}: image {spec['image']!r} is not known here")
    return builder(spec)


def build_extractor(spec: Spec) -> Lbp | Haralick | Join:
    """Build the extractor a spec describes.

    Raises
    ------
    ToktError
        If the spec names an extractor, version or option this tokt does not know. A spec is
        never read with a part of it ignored.
    """
    if _check_head(spec) != "join":
        return _plain_from(spec)
    _check_keys(spec, {"name", "version", "parts"})
    parts = spec["parts"]
    if not isinstance(parts, list) or len(parts) < 2:
        raise ToktError("extractor join: takes two or more plain extractors")
    return Join([_plain_from(part) for part in parts])


NAMED: dict[str, Lbp | Haralick] = {
    "lbp": Lbp(10, 5, "patch"),
    "lbp_10_5": Lbp(10, 5, "patch"),
    "lbp_24_8": Lbp(24, 8, "patch"),
    "lbp_10_5_frame": Lbp(10, 5, "frame"),
    "lbp_24_8_frame": Lbp(24, 8, "frame"),
    "haralick": Haralick(ignore_zeros=False),
}


def extractor_named(text: str) -> Lbp | Haralick | Join:
    """The extractor behind a name, or behind several joined by ``+``.

    Examples
    --------
    >>> extractor_named("haralick+lbp_24_8_frame").dim
    39

    Raises
    ------
    ToktError
        If a name is not known.
    """
    parts = []
    for name in text.split("+"):
        if name not in NAMED:
            raise ToktError(f"unknown extractor {name!r} (known: {', '.join(NAMED)}; join with +)")
        parts.append(NAMED[name])
    return parts[0] if len(parts) == 1 else Join(parts)
