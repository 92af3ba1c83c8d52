"""Estimators for scikit-learn: features of patches, the splitter of dives, datasets.

It needs the extra ``train``. A sample is a patch; the samples X of every transformer are one of:

- `Patches` within their frames, of `patches_of` or `load_dataset`. Their features are those of
  tokt itself, bit for bit: a feature may look at the neighbours or at the whole frame.
- Ready-cut patches: uint8, shape (n, height, width) or (n, height, width, 3), gray or BGR, or a
  list of such patches of any sizes. Each is a frame of one patch, with nothing around it. Its
  features are the same only where a spec looks at each patch alone: ``border="patch"``, and
  no ``flatten``, no ``context``, no ``relative``.

``Pipeline(..., memory=DIR)`` keeps features between the fits of a search.

Examples
--------
>>> import numpy as np
>>> from sklearn.pipeline import make_pipeline
>>> from sklearn.svm import LinearSVC
>>> frames = np.random.default_rng(0).integers(0, 256, (2, 271, 360), np.uint8)
>>> frames[1] //= 128
>>> X, y = patches_of(frames), np.repeat([1, 0], 100)
>>> model = make_pipeline(LBP(border="frame"), LinearSVC()).fit(X, y)
>>> model.predict(X[99:101])
array([1, 0])
>>> from sklearn.model_selection import cross_val_score
>>> X, y = load_dataset("tower", return_X_y=True)  # doctest: +SKIP
>>> cross_val_score(model, X, y, cv=DiveSplit())  # doctest: +SKIP
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.model_selection import BaseCrossValidator
from sklearn.utils import Bunch, Tags

from tokt.features.common.arrays import F64, I64, U8
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import Extractor, build_extractor, extractor_named
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.kernels.checks import check_frame
from tokt.training.datasets.dataset import FRAME_KEY, DatasetVersion, open_dataset
from tokt.training.datasets.folds import (
    BLOCK,
    BLOCK_FRAMES,
    DIVE,
    FOLDS,
    Fold,
    dive_folds,
    embargo_of,
)
from tokt.training.datasets.mission_source import PATCH_GRID
from tokt.training.datasets.split import Split

__all__ = ["LBP", "DiveSplit", "Haralick", "PatchFeatures", "Patches", "WaterFeatures"]
__all__ += ["load_dataset", "patches_of"]
_GROUPS = ["mission", "frame", "group", "site"]


class SampleError(ToktError, ValueError):
    """Samples, labels or groups that no estimator here can take."""


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches within their frames, indexed like an array; see `patches_of` and `load_dataset`.

    Parameters
    ----------
    read : callable
        Gives a frame by its number: uint8, gray or BGR, any size.
    grid : Grid
    frame, cell : arrays of int, shape (n,)
        Each patch's frame, and its place there: ``row * grid.cols + col``.
    groups : DataFrame, optional
        For each patch what `DiveSplit` reads: mission, frame, group, site.
    """

    read: Callable[[int], U8]
    grid: Grid
    frame: I64
    cell: I64
    groups: pd.DataFrame | None = None

    @property
    def shape(self) -> tuple[int]:
        """``(n,)``."""
        return (len(self.frame),)

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, rows: Any) -> Self:
        """Some of the patches; scikit-learn asks for ``[rows, ...]``."""
        kept = np.atleast_1d(np.arange(len(self))[rows])
        if kept.ndim > 1:
            raise IndexError("patches have one dimension")
        groups = None if self.groups is None else self.groups.iloc[kept]
        return type(self)(self.read, self.grid, self.frame[kept], self.cell[kept], groups)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NoReturn:
        raise SampleError("patches are no table of numbers: a pipeline starts with LBP() or so")


def patches_of(frames: Sequence[U8] | U8, grid: Grid | str = DEFAULT_GRID) -> Patches:
    """Every patch of some frames: frame by frame, row by row.

    Parameters
    ----------
    frames : sequence of arrays of uint8
        Shape (height, width) or (height, width, 3), gray or BGR, any sizes.
    grid : Grid or str
        Such as ``"10x10@360"``.

    Raises
    ------
    ToktError
        If that is no grid, or those are no frames.
    """
    grid = Grid.parse(grid) if isinstance(grid, str) else grid
    if isinstance(frames, np.ndarray) and frames.shape[2:] == (3,) and grid != PATCH_GRID:
        raise SampleError(f"an array {frames.shape} is one colour frame: give a list of frames")
    try:
        sound = [check_frame(frame) for frame in frames]
    except (TypeError, ValueError) as error:
        raise SampleError(f"frames and patches are images of uint8, gray or BGR: {error}") from None
    frame, cell = np.divmod(np.arange(len(sound) * grid.n_patches), grid.n_patches)
    return Patches(sound.__getitem__, grid, frame, cell)


def load_dataset(
    dataset: str | DatasetVersion, workspace: str | Path = ".tokt", *, return_X_y: bool = False
) -> Any:
    """Load a dataset version as scikit-learn's own ``load_*`` functions do.

    Parameters
    ----------
    dataset : str or DatasetVersion
        ``NAME``, of which the latest, or ``NAME@HASH``, in the folder `workspace`.
    return_X_y : bool
        Whether to give ``(data, target)`` alone.

    Returns
    -------
    Bunch
        ``data``: `Patches`. ``target``: int, indices into ``target_names``. ``groups``: DataFrame
        for `DiveSplit` where X is a table of features. ``label``: ``NAME@HASH``.

    Raises ToktError if there is no such dataset, or it was changed on disk. Frames are checked as
    they are read.
    """
    if isinstance(dataset, str):
        dataset = open_dataset(dataset, Path(workspace) / "datasets")
    dataset.check()
    patches, target, names = dataset.patches, dataset.targets(), np.array(dataset.classes())
    places = pd.MultiIndex.from_frame(dataset.frames[FRAME_KEY])
    frame = places.get_indexer(pd.MultiIndex.from_frame(patches[FRAME_KEY]))
    cell = (patches.row * dataset.grid.cols + patches.col).to_numpy(np.int64)
    groups = patches.assign(site=[dataset.sites.get(name, "") for name in patches.mission])
    groups["block_frames"] = dataset.block_frames or 0
    groups["single_picture"] = groups.mission.isin(dataset.single_pictures)
    if dataset.block_frames is None:
        groups["frame"] = groups["position"] = np.nan  # they count files: none is near another
    data = Patches(dataset.read_frame, dataset.grid, frame, cell, groups)
    whole = Bunch(data=data, target=target, target_names=names, groups=groups, label=dataset.label)
    return (data, target) if return_X_y else whole


def _patches(X: Any) -> Patches:
    """X as patches within frames; a ready-cut patch is a frame of one patch."""
    images = isinstance(X, list) or (isinstance(X, np.ndarray) and X.ndim in (3, 4))
    if not images and not isinstance(X, Patches):
        what = f"{type(X).__name__} {getattr(X, 'shape', '')}".strip()
        raise SampleError(
            f"X is {what}: it has to be Patches, or images of uint8 (n, height, width[, 3]); "
            "rows of flat images become images by X.reshape(-1, HEIGHT, WIDTH)"
        )
    patches = X if isinstance(X, Patches) else patches_of(X, PATCH_GRID)
    if not len(patches):
        raise SampleError("X has 0 sample(s), while a minimum of 1 is required")
    return patches


class _PatchTransformer(TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """What the transformers share. Nothing is learnt: each may be used without `fit`."""

    def _spec(self) -> Mapping[str, Any]:
        raise NotImplementedError

    def extractor(self) -> Extractor:
        """The extractor; ``tokt train --extractor spec:FILE`` takes its ``spec`` as JSON.

        Raises ToktError if a parameter is out of range.
        """
        # A search gives numbers of numpy, which JSON does not have.
        spec = self._spec().items()
        return build_extractor({k: v.item() if isinstance(v, np.generic) else v for k, v in spec})

    def fit(self, X: Any, y: Any = None) -> Self:
        """Check parameters and samples; `y` is ignored. Raises as `transform`."""
        self.extractor()
        _patches(X)
        return self

    def transform(self, X: Any) -> F64:
        """Features of patches: float64, shape (n_patches, n_features), in the order of X.

        Raises ToktError if a parameter is out of range, or X is no patches that can be read.
        """
        patches, extractor = _patches(X), self.extractor()
        table = np.empty((len(patches), extractor.dim))
        for frame, rows in pd.Series(patches.frame).groupby(patches.frame).indices.items():
            features = extractor.describe(patches.read(frame), patches.grid)
            table[rows] = features[patches.cell[rows]]
        return table

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[np.object_]:
        """One name a feature; `input_features` is ignored."""
        return np.array(self.extractor().names, object)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.requires_fit = tags.input_tags.two_d_array = False
        tags.input_tags.three_d_array = True
        return tags


class LBP(_PatchTransformer):
    """Normalised histograms of uniform local binary patterns (thesis section 3.4).

    Parameters
    ----------
    points, radius : int
        Points on a circle (4 to 64), and its radius in pixels (1 to 32).
    border : {"patch", "frame"}
        Whether a point beyond the patch is 0, as in the thesis, or the neighbour's pixel.
    """

    def __init__(self, points: int = 10, radius: int = 5, border: str = "patch") -> None:
        self.points = points
        self.radius = radius
        self.border = border

    def _spec(self) -> Mapping[str, Any]:
        own = {"points": self.points, "radius": self.radius, "border": self.border}
        return {**extractor_named("lbp").spec, **own}


class Haralick(_PatchTransformer):
    """Haralick's first 13 features of co-occurring grey levels (thesis section 3.5).

    Parameters
    ----------
    log : bool
        Whether the features that grow with contrast are given as logarithms.
    ignore_zeros : bool
        Whether grey level 0 is left out, as in the thesis.
    """

    def __init__(self, log: bool = False, ignore_zeros: bool = False) -> None:
        self.log = log
        self.ignore_zeros = ignore_zeros

    def _spec(self) -> Mapping[str, Any]:
        spec = extractor_named("haralick_log" if self.log else "haralick").spec
        return {**spec, "ignore_zeros": self.ignore_zeros}


class WaterFeatures(_PatchTransformer):
    """Features of preset ``water``: how a patch differs from the water of its own frame.

    A ready-cut patch has no frame to differ from: give `Patches`.

    Parameters
    ----------
    colour : bool
        Whether colour is looked at; gray frames are frames without colour then.
    quietest : float
        Part of a frame's patches that stands for its water, above 0, at most 1.
    """

    def __init__(self, colour: bool = True, quietest: float = 0.3) -> None:
        self.colour = colour
        self.quietest = quietest

    def _spec(self) -> Mapping[str, Any]:
        spec = extractor_named("water" if self.colour else "water_gray").spec
        given: Any = self.quietest
        taking = spec if self.colour else spec["parts"][0]["part"]
        taking["quietest"] = float(given) if isinstance(given, Real) else given
        return spec


class PatchFeatures(_PatchTransformer):
    """Features of any extractor that tokt knows.

    Parameters
    ----------
    spec : str or dict
        A name, names joined by ``+``, ``spec:FILE.json``, or a JSON spec; see
        `tokt.features.extractors.extractor`.
    """

    def __init__(self, spec: str | Mapping[str, Any] = "lbp") -> None:
        self.spec = spec

    def _spec(self) -> Mapping[str, Any]:
        given = self.spec
        return given if isinstance(given, Mapping) else extractor_named(str(given)).spec


class DiveSplit(BaseCrossValidator):  # type: ignore[misc]
    """Cross-validation in the folds of ``tokt train``: whole dives, or blocks of frames.

    Give it as `cv` everywhere: any other splitter tests on near copies of what was learnt. The
    ``best_score_`` of a search is too good; score the search itself by `cross_val_score`.

    Parameters
    ----------
    n_splits : int, optional
        Folds of blocks, or of more than sixteen dives; fewer dives are held out one by one. By
        default as many as the labelled frames can bear: five, or fewer, or each frame alone.
    embargo_frames : int, optional
        Training patches so near to a test frame of their dive, or nearer, are left out. By default
        a quarter of a block of `load_dataset`, and none between single pictures.
    by : {"dive", "block"}, optional
        What is held out; by default dives, or their sites, where there are several.
    """

    __metadata_request__split = {"groups": True}  # noqa: RUF012

    def __init__(
        self, n_splits: int | None = None, embargo_frames: int | None = None, by: str | None = None
    ) -> None:
        self.n_splits = n_splits
        self.embargo_frames = embargo_frames
        self.by = by

    def split(self, X: Any, y: Any = None, groups: Any = None) -> Iterator[tuple[I64, I64]]:
        """Rows to train on and rows to test on, fold by fold, each with its share of every class.

        X is of `load_dataset`; `groups` are needed where it is anything else. Raises ToktError if
        groups or labels are missing, or too few to be split so.
        """
        for fold in self._folds(X, y, groups):
            yield fold.train, fold.test

    def get_n_splits(self, X: Any = None, y: Any = None, groups: Any = None) -> int:
        """How many folds `split` gives."""
        return len(self._folds(X, y, groups))

    def _folds(self, X: Any, y: Any, groups: Any) -> list[Fold]:
        groups = X.groups if groups is None and isinstance(X, Patches) else groups
        if not isinstance(groups, pd.DataFrame) or not set(_GROUPS) <= set(groups.columns):
            raise SampleError(
                f"DiveSplit needs the {', '.join(_GROUPS)} of each patch: X of load_dataset, or "
                "its groups, a DataFrame"
            )
        if y is None or len(y) != len(groups):
            raise SampleError(f"DiveSplit needs y, a label for each of {len(groups)} patches")
        targets = np.unique(y, return_inverse=True)[1]
        sites = {m: s for m, s in zip(groups.mission, groups.site, strict=True) if s}
        by = self.by or (DIVE if groups.mission.nunique() > 1 else BLOCK)
        block = int(groups.block_frames.max()) if "block_frames" in groups else BLOCK_FRAMES
        embargo = embargo_of(block) if self.embargo_frames is None else self.embargo_frames
        folds = FOLDS if self.n_splits is None else self.n_splits
        single = groups.mission[groups.single_picture] if "single_picture" in groups else []
        try:
            split = Split(
                folds, embargo, by, sites=sites, single_pictures=tuple(dict.fromkeys(single))
            )
        except (TypeError, ValueError):
            words = "n_splits from 2, embargo_frames from 0, by 'dive' or 'block'"
            raise SampleError(f"DiveSplit takes {words}") from None
        if self.by == DIVE and not dive_folds(groups, targets, sites, folds, False):
            raise SampleError("by='dive' takes two dives with every class, and no common picture")
        if self.n_splits is None:
            by_choice = self.by is None
            split = split.borne_by(groups, targets, block, with_choices=False, or_blocks=by_choice)
        return split.cut(groups, targets)
