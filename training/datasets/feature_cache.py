"""A cache of the features of a dataset's patches, computed once for an extractor."""

import hashlib
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tokt import features as features_package
from tokt.features.common import atomic
from tokt.features.common.arrays import F64, I64
from tokt.features.common.canonical import json_sha256
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.grid import Grid
from tokt.features.frames.view_mask import ViewMask
from tokt.features.kernels.dispatch import KERNELS, LIBRARY
from tokt.training.parallel import mapped

from . import augmentations, frame_rows
from .dataset import FRAME_KEY, DatasetVersion, read_stored_frame
from .frame_rows import SUFFIX as ROWS
from .frame_rows import read_frame_rows

_LIBRARIES = ("numpy", "opencv-python-headless")
_REFERENCES = ("scikit-image", "mahotas")
_CODE = {".py", ".so", ".pyd"}
_CHANGING = ("augmentations.py", "changed_patches.py", "frame_changes.py")


def _source_hash() -> str:
    """Hash of the code that computes features, compiled or not: a cache must not outlive it."""
    digest = hashlib.sha256(KERNELS.name.encode("ascii"))
    for path in sorted(Path(features_package.__file__).parent.rglob("*")):
        if path.suffix in _CODE:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def feature_key(
    dataset: DatasetVersion,
    spec: dict[str, Any],
    augmentation: str = "",
    whole_frames: bool = False,
) -> str:
    """A name for a dataset's features: another one whenever they might come out otherwise.

    It covers the dataset, the spec, this code and the versions of the libraries that compute.
    """
    computing = _LIBRARIES + (_REFERENCES if KERNELS.name == LIBRARY else ())
    libraries = {name: version(name) for name in computing}
    parts = [dataset.hash, spec, libraries, _source_hash()]
    if augmentation:
        folder = Path(augmentations.__file__).parent
        code = b"".join((folder / name).read_bytes() for name in _CHANGING)
        parts += [augmentation, hashlib.sha256(code).hexdigest()]
    if whole_frames:
        parts.append("labelled first")
    if not dataset.pictured.all():
        parts.append(hashlib.sha256(Path(frame_rows.__file__).read_bytes()).hexdigest())
    return json_sha256(parts)[:24]


_DescribeTask = tuple[Path, str, ViewMask | None, I64, dict[str, Any], Grid, str]


def _describe(task: _DescribeTask) -> F64:
    path, digest, mask, cells, spec, grid, augmentation = task
    if path.suffix == ROWS:
        if augmentation:
            raise ToktError(f"dataset frames {path}: no pictures that {augmentation} could change")
        return read_frame_rows(path, digest, spec).values[cells]
    frame = read_stored_frame(path, digest, mask)
    if augmentation:
        frame = augmentations.augment(frame, augmentation)
    return build_extractor(spec).describe(frame, grid)[cells]


def _cached(path: Path, shape: tuple[int, int]) -> F64 | None:
    """An earlier result, if it is there and whole."""
    check = path.with_suffix(".sha256")
    try:
        table: F64 = np.load(path, mmap_mode="r", allow_pickle=False)
        if check.read_text("ascii") != hashlib.sha256(table.data).hexdigest():
            return None
    except (OSError, ValueError, EOFError):
        return None
    return table if table.shape == shape and table.dtype == np.float64 else None


def cached_features(
    dataset: DatasetVersion,
    spec: dict[str, Any],
    cache: Path,
    progress: Callable[..., Any],
    jobs: int = -1,
    dask: str | None = None,
    augmentation: str = "",
    whole_frames: bool = False,
) -> F64:
    """Features of every patch of a dataset, in the order of ``dataset.patches``.

    Parameters
    ----------
    spec : dict
        The extractor's spec.
    cache : Path
        Folder of earlier results; the key covers dataset, spec, code and library versions.
    progress : callable
        ``progress(items, total, what)`` passes the items through.
    jobs : int
        Processes; -1 for one a core. The result does not depend on it.
    dask : str, optional
        Address of a dask scheduler, whose workers see the dataset under the same path. The
        result does not depend on it either.
    augmentation : str
        Name of an augmentation (`augmentations`) that every frame goes through first.
    whole_frames : bool
        After the labelled patches also the others of their frames: by mission, camera and number of
        the frame, then by row and column.

    Returns
    -------
    numpy.ndarray
        float64, shape (n_patches, dim), memory-mapped read-only.
    """
    key = feature_key(dataset, spec, augmentation, whole_frames)
    path = cache / f"{dataset.name}-{key}.npy"
    tasks = _tasks(dataset, spec, augmentation, whole_frames)
    shape = (sum(len(rows) for rows, _ in tasks), build_extractor(spec).dim)
    what = f"features, {augmentation}" if augmentation else "features"
    return cached_table(tasks, _describe, path, shape, what, progress, jobs, dask)


def cached_table(
    tasks: Sequence[tuple[I64, Any]],
    describe: Callable[[Any], F64],
    path: Path,
    shape: tuple[int, int],
    what: str,
    progress: Callable[..., Any],
    jobs: int = -1,
    dask: str | None = None,
) -> F64:
    """A table of float64 of this shape, from the file `path` or computed and kept there.

    `tasks` are pairs of rows of the table and what `describe` makes their values of; `what` is what
    to call them. The others are as in `cached_features`.
    """
    table = _cached(path, shape)
    if table is None:
        atomic.remove_partials(path.parent, atomic.ABANDONED_S)
        with atomic.scratch_folder(path) as folder:
            written = np.lib.format.open_memmap(folder / path.name, "w+", np.float64, shape)
            described = mapped(describe, (task for _, task in tasks), jobs, dask)
            results = progress(described, len(tasks), what)
            for (rows, _), values in zip(tasks, results, strict=True):
                written[rows] = values
            written.flush()
            digest = hashlib.sha256(written.data).hexdigest()
            del written
            atomic.write_text(path.with_suffix(".sha256"), digest)
            atomic.rename(folder / path.name, path)
        table = _cached(path, shape)
    if table is None:
        raise ToktError(f"feature cache {path} cannot be read back; is the disk full?")
    return np.asarray(table)  # what is cut from it is of memory


def _tasks(
    dataset: DatasetVersion, spec: dict[str, Any], augmentation: str, whole_frames: bool
) -> list[tuple[I64, _DescribeTask]]:
    """The dataset's frames, each with the rows of its patches; of what is not labelled the last."""
    patches, frames, grid = dataset.patches, dataset.frames, dataset.grid
    folder, columns = dataset.path.resolve() / "frames", frames[[*FRAME_KEY, "file", "digest"]]
    stored = {
        tuple(key): (folder / file, digest, dataset.mask(index))
        for index, (*key, file, digest) in enumerate(columns.itertuples(index=False, name=None))
    }
    groups = patches.groupby(FRAME_KEY).indices
    labelled = (patches.row * grid.cols + patches.col).to_numpy()
    tasks, after = list[tuple[I64, _DescribeTask]](), len(patches)
    for key, rows in sorted(groups.items()):
        cells = labelled[rows]
        if whole_frames:
            others = np.setdiff1d(np.arange(grid.n_patches), cells)
            rows = np.append(rows, after + np.arange(len(others)))
            cells, after = np.append(cells, others), after + len(others)
        tasks.append((rows, (*stored[key], cells, spec, grid, augmentation)))
    return tasks
