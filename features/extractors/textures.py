"""The extractors, and the interface of all: a frame and a grid in, one feature row a patch out.

Those of one picture come first, then what is made of several: a join, a patch with its neighbours.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import deepcopy
from math import prod
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.frames.grid import Grid
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import Quantization

from .frame_pictures import FramePictures

SPEC_VERSION = 1
PLAIN_IMAGE = {"resize": "area", "gray": "bt601"}


class Extractor(ABC):
    """Turns a frame into features, one row a patch, by pictures that are prepared from it.

    Attributes
    ----------
    dim : int
        Number of features of one patch.
    names : tuple of str
        One name a feature.
    images : tuple of Quantization or None
        The distinct quantized pictures it looks at; None is the plain one.
    needs_colour : bool
        Whether it cannot describe gray frames.
    energies : tuple of bool
        For each feature whether it is a logarithm of how much a patch changes within; empty where
        none is.
    """

    dim: int
    names: tuple[str, ...]
    images: tuple[Quantization | None, ...]
    needs_colour = False
    energies: tuple[bool, ...] = ()
    _spec: dict[str, Any]  # which every class sets; `spec` gives it out as a copy

    @property
    def spec(self) -> dict[str, Any]:
        """The JSON spec that describes this extractor whole, and that it can be built from."""
        return deepcopy(self._spec)

    def describe(self, frame: U8, grid: Grid) -> F64:
        """Features of every patch: float64, shape (grid.n_patches, dim), row by row.

        Parameters
        ----------
        frame : array of uint8, shape (height, width) or (height, width, 3)
            As the camera gave it, gray or BGR, any size.
        grid : Grid
        """
        return self.describe_pictures(FramePictures(frame, grid))

    def is_gray(self, features: F64, *, of_4_bits: bool = False) -> Bools:
        """Tell of each row of features whether its frame has no colour, shape (n,).

        False of an extractor that does not look at colours. `of_4_bits`: the features are those
        that a file of rows keeps.
        """
        return np.zeros(len(features), bool)

    @abstractmethod
    def describe_pictures(self, pictures: FramePictures) -> F64:
        """`describe`, of a frame whose prepared pictures are shared with others."""


class OnePicture(Extractor):
    """An extractor that works on one picture, each patch by itself.

    The image says how that picture is prepared; another than the plain one goes before the
    features' names. With `sampling` or `scale`, which version 1 does not know, a spec is of
    version 2.
    """

    def __init__(
        self,
        name: str,
        options: dict[str, Any],
        image: Quantization | None,
        names: Sequence[str],
        *,
        sampling: str | None = None,
        scale: str | None = None,
    ) -> None:
        self.image = image
        self.images = (image,)
        self.names = tuple(names if image is None else (f"{image.label}.{each}" for each in names))
        self.dim = len(self.names)
        later = {"sampling": sampling, "scale": scale}
        newer = {key: value for key, value in later.items() if value is not None}
        version = 2 if newer else SPEC_VERSION
        shown = PLAIN_IMAGE if image is None else image.to_json()
        self._spec = {"name": name, "version": version, **options, "image": shown, **newer}


BILINEAR, NEAREST = "bilinear", "nearest"


class Lbp(OnePicture):
    """Normalised histograms of uniform local binary patterns (thesis section 3.4).

    Parameters
    ----------
    points, radius : int
        P sampling points on a circle of R pixels.
    border : {"patch", "frame"}
        Whether a point beyond the patch is 0 or the neighbour's pixel.
    image : Quantization, optional
    sampling : {"bilinear", "nearest"}, optional
        Between pixels, or at the nearest one; not given, bilinear by a spec of version 1.
    """

    def __init__(
        self,
        points: int,
        radius: int,
        border: str,
        image: Quantization | None = None,
        sampling: str | None = None,
    ) -> None:
        options = {"points": points, "radius": radius, "border": border}
        kind = "lbp_nearest" if sampling == NEAREST else "lbp"
        bins = [*range(points + 1), "other"]
        names = [f"{kind}_{points}_{radius}_{border}_{pattern}" for pattern in bins]
        super().__init__("lbp", options, image, names, sampling=sampling)
        self.sampling = sampling
        self.points = points
        self.radius = radius
        self.border = border

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """Fraction of a patch's pixels with each pattern; rows sum to 1."""
        picture, grid = pictures.picture(self.image), pictures.grid
        kernel = KERNELS.lbp_nearest_counts if self.sampling == NEAREST else KERNELS.lbp_counts
        counts = kernel(picture, grid, self.points, self.radius, self.border, pictures.threads)
        return counts / float(prod(grid.patch_size(*picture.shape)))


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
LINEAR, LOG = "linear", "log"
_LOG_NAMES = dict.fromkeys(
    ("contrast", "correlation", "sum_of_squares", "sum_variance", "difference_variance"), "_log"
)
_LEAST = 0.1  # squared levels, small beside those of a picture with any texture


class Glcm(OnePicture):
    """Haralick's first 13 features, mean over 4 directions (thesis section 3.5)."""

    def __init__(
        self, ignore_zeros: bool, image: Quantization | None = None, scale: str | None = None
    ) -> None:
        shown = _LOG_NAMES if scale == LOG else {}
        names = [f"haralick_{name}{shown.get(name, '')}" for name in HARALICK_NAMES]
        super().__init__("haralick", {"ignore_zeros": ignore_zeros}, image, names, scale=scale)
        self.ignore_zeros = ignore_zeros
        self.scale = scale

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """The 13 features of each patch's grey-level co-occurrence matrices (GLCM)."""
        picture = pictures.picture(self.image)
        features = KERNELS.haralick_features(
            picture, pictures.grid, self.ignore_zeros, pictures.threads
        )
        return on_log_scale(features) if self.scale == LOG else features


def on_log_scale(features: F64) -> F64:
    """Features of shape (n, 13) with those that grow with contrast as logarithms.

    A linear model then sees what is faint and what is close on one scale; the correlation, which
    crowds below 1, is spread by the inverse hyperbolic tangent.
    """
    out = features.copy()
    for place, name in enumerate(HARALICK_NAMES):
        if name == "correlation":
            out[:, place] = np.arctanh(out[:, place].clip(-0.99, 0.9999))
        elif name in _LOG_NAMES:
            out[:, place] = np.log(out[:, place] + _LEAST)
    return out


_NO_LINE = 0.25  # levels that count as no line at all: the logarithm of less says nothing


class Lines(OnePicture):
    """For each number of samples: ridge contrast, energy of the strongest line, and its lead.

    The legs of a tower are long lines before they are anything else, while what drifts in the water
    are dots: a mean along a line keeps the one and loses the other. A line has increasing powers of
    2 samples, 2 to 64.
    """

    def __init__(self, samples: Sequence[int], image: Quantization | None = None) -> None:
        kinds = ("ridge", "strongest", "one_way")
        names = [f"lines_{n}_{kind}" for n in samples for kind in kinds]
        super().__init__("lines", {"samples": list(samples)}, image, names)
        self.samples = tuple(samples)

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch."""
        picture, grid = pictures.picture(self.image), pictures.grid
        middle = (256 if self.image is None else self.image.levels) // 2
        sums = KERNELS.line_sums(picture, grid, middle, self.samples, pictures.threads)
        pixels = float(prod(grid.patch_size(*picture.shape)))
        n = np.array(self.samples, np.float64)
        ridge = sums[:, :, 0] / (8 * n * pixels)
        energy = sums[:, :, 1:] / (n * n * pixels)[:, None]
        strongest = np.log(energy.max(axis=2) + _NO_LINE**2)
        one_way = strongest - np.log(energy.mean(axis=2) + _NO_LINE**2)
        features = np.stack([np.log(ridge + _NO_LINE), strongest, one_way], axis=2)
        return features.reshape(grid.n_patches, self.dim)


PERCENTS = (2, 10, 50, 90, 98)


class Moments(OnePicture):
    """Mean, standard deviation, extremes and percentiles of a patch's levels."""

    def __init__(self, image: Quantization | None = None) -> None:
        names = ("mean", "std", "min", "max", *(f"percentile_{part}" for part in PERCENTS))
        super().__init__("moments", {}, image, [f"moments_{name}" for name in names])

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch, in levels."""
        picture = pictures.picture(self.image)
        return moments_of(KERNELS.level_counts(picture, pictures.grid, pictures.threads))


def moments_of(counts: I64) -> F64:
    """The features of histograms of 256 levels, shape (n, 256), as (n, 9).

    A percentile p is the lowest level that p % of the pixels do not exceed. All sums are of whole
    numbers, the variance's around one next to the mean.
    """
    level = np.arange(counts.shape[1])
    up_to = counts.cumsum(axis=1)
    n = up_to[:, -1]
    total = counts @ level
    middle = (total + n // 2) // n
    shift = (total - middle * n) / n
    spread = (counts * (level - middle[:, None]) ** 2).sum(axis=1)
    variance = np.maximum(spread / n - shift * shift, 0)
    seen = counts > 0
    extremes = seen.argmax(axis=1), counts.shape[1] - 1 - seen[:, ::-1].argmax(axis=1)
    percentiles = [(100 * up_to >= part * n[:, None]).argmax(axis=1) for part in PERCENTS]
    return np.stack([total / n, np.sqrt(variance), *extremes, *percentiles], axis=1)


_NO_EDGE = 0.25  # squared levels that count as no edge at all: the logarithm of less says nothing


class Structure(OnePicture):
    """The structure tensor of each patch: its eigenvalues' logarithms, and its coherence.

    Bigun, Granlund (1987), "Optimal orientation detection of linear symmetry", ICCV.
    """

    def __init__(self, image: Quantization | None = None) -> None:
        names = ("structure_strong", "structure_weak", "structure_coherence")
        super().__init__("structure", {}, image, names)

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """One row a patch."""
        picture, grid = pictures.picture(self.image), pictures.grid
        sums = KERNELS.structure_sums(picture, grid, pictures.threads)
        # Neighbours are two pixels apart: a difference is twice the slope.
        across, down, both = (sums / (4.0 * prod(grid.patch_size(*picture.shape)))).T
        trace = across + down
        apart = np.sqrt((across - down) ** 2 + 4 * both**2)
        strong, weak = (trace + apart) / 2, np.maximum(trace - apart, 0) / 2
        return np.stack(
            [np.log(strong + _NO_EDGE), np.log(weak + _NO_EDGE), apart / (trace + _NO_EDGE)], axis=1
        )


class Join(Extractor):
    """Several extractors' features side by side; pictures they share are prepared once."""

    def __init__(self, parts: Sequence[Extractor]) -> None:
        self.parts = tuple(parts)
        self.images = tuple(dict.fromkeys(image for part in parts for image in part.images))
        self.dim = sum(part.dim for part in self.parts)
        self.names = tuple(name for part in self.parts for name in part.names)
        self.needs_colour = any(part.needs_colour for part in self.parts)
        energies = (part.energies or (False,) * part.dim for part in self.parts)
        self.energies = tuple(flag for flags in energies for flag in flags)
        specs = [part.spec for part in self.parts]
        self._spec = {"name": "join", "version": SPEC_VERSION, "parts": specs}

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """The parts' features, in order."""
        return np.hstack([part.describe_pictures(pictures) for part in self.parts])


class Half(Extractor):
    """A part that looks at the frame at half the width and height: a quarter of the work."""

    images = ()

    def __init__(self, part: Extractor) -> None:
        self.part = part
        self.dim = part.dim
        self.names = tuple(f"half.{name}" for name in part.names)
        self.needs_colour = part.needs_colour
        self.energies = part.energies
        self._spec = {"name": "half", "version": SPEC_VERSION, "part": part.spec}

    def is_gray(self, features: F64, *, of_4_bits: bool = False) -> Bools:
        """As the part tells."""
        return self.part.is_gray(features, of_4_bits=of_4_bits)

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """The part's features of the pictures at half the width."""
        return self.part.describe_pictures(pictures.halved)


_AROUND = [(down, right) for down in range(3) for right in range(3) if (down, right) != (1, 1)]


def _around_each(features: F64, grid: Grid, beyond: float) -> list[F64]:
    """The features of each patch's eight neighbours, `beyond` where there is none."""
    rows, cols = grid.rows, grid.cols
    padded = np.full((rows + 2, cols + 2, features.shape[1]), beyond)
    padded[1:-1, 1:-1] = features.reshape(rows, cols, -1)
    return [padded[down : down + rows, right : right + cols] for down, right in _AROUND]


def _mean_around(features: F64, grid: Grid) -> F64:
    # One after the other, so that the order of adding is the same everywhere.
    sums, *others = (part.copy() for part in _around_each(features, grid, 0.0))
    for other in others:
        sums += other
    ones = np.ones((grid.n_patches, 1))
    return np.asarray(sums / np.sum(_around_each(ones, grid, 0.0), axis=0))


def _max_around(features: F64, grid: Grid) -> F64:
    return np.asarray(np.max(_around_each(features, grid, -np.inf), axis=0))


def _min_around(features: F64, grid: Grid) -> F64:
    return np.asarray(np.min(_around_each(features, grid, np.inf), axis=0))


STATISTICS: dict[str, Callable[[F64, Grid], F64]] = {
    "mean": _mean_around,
    "max": _max_around,
    "min": _min_around,
    "range": lambda rows, grid: _max_around(rows, grid) - _min_around(rows, grid),
}


def around(features: F64, grid: Grid, statistic: str) -> F64:
    """A statistic of each patch's neighbours, up to eight, inside the grid: (n_patches, dim).

    The one patch of a grid is its own neighbour.
    """
    if grid.n_patches == 1:
        # Not the features themselves: the range of one value is none.
        return features - features if statistic == "range" else features
    return STATISTICS[statistic](features, grid).reshape(features.shape)


class Context(Extractor):
    """A part's features, followed by one of `STATISTICS` of the neighbours' ones."""

    def __init__(self, part: Extractor, statistic: str) -> None:
        self.part = part
        self.images = part.images
        self.needs_colour = part.needs_colour
        self.statistic = statistic
        self.dim = 2 * part.dim
        self.names = part.names + tuple(f"around_{statistic}.{name}" for name in part.names)
        made = {"part": part.spec, "statistic": statistic}
        self._spec = {"name": "context", "version": SPEC_VERSION, **made}

    def describe_pictures(self, pictures: FramePictures) -> F64:
        """The part's features, then the neighbours'."""
        own = self.part.describe_pictures(pictures)
        return np.hstack([own, around(own, pictures.grid, self.statistic)])
