"""The features of a dataset's patches, computed once for an extractor and kept."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from .. import features as features_package
from ..features import atomic
from ..features.canonical import json_sha256
from ..features.errors import ToktError
from ..features.extractor import build_extractor
from ..features.grid import Grid
from ..features.kernels import KERNELS, LIBRARY
from .dataset import DatasetVersion, read_stored_frame

_LIBRARIES = ("numpy", "opencv-python-headless")
_REFERENCES = ("scikit-image", "mahotas")
_CODE = {".py", ".so", ".pyd"}


def _source_hash() -> str:
    """Hash of the code that computes features, compiled or not: a cache must not outlive it."""
    digest = hashlib.sha256(KERNELS.name.encode("ascii"))
    for path in sorted(Path(features_package.__file__).parent.iterdir()):
        if path.suffix in _CODE:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _cache_key(dataset: DatasetVersion, spec: dict[str, Any]) -> str:
    computing = _LIBRARIES + (_REFERENCES if KERNELS.name == LIBRARY else ())
    libraries = {name: version(name) for name in computing}
    return json_sha256([dataset.hash, spec, libraries, _source_hash()])[:24]


def _describe(
    path: Path, digest: str, cells: NDArray[np.int64], spec: dict[str, Any], grid: Grid
) -> NDArray[np.float64]:
    return build_extractor(spec).describe(read_stored_frame(path, digest), grid)[cells]


def _cached(path: Path, shape: tuple[int, int]) -> NDArray[np.float64] | None:
    """An earlier result, if it is there and whole."""
    check = path.with_suffix(".sha256")
    try:
        table: NDArray[np.float64] = np.load(path, mmap_mode="r", allow_pickle=False)
        if check.read_text("ascii") != hashlib.sha256(table.data).hexdigest():
            return None
    except (OSError, ValueError, EOFError):
        return None
    return table if table.shape == shape and table.dtype == np.float64 else None


def feature_table(
    dataset: DatasetVersion,
    spec: dict[str, Any],
    cache: Path,
    progress: Callable[..., Any],
    jobs: int = -1,
) -> NDArray[np.float64]:
    """Features of every patch of a dataset, in the order of ``dataset.patches``.

    Parameters
    ----------
    dataset : DatasetVersion
    spec : dict
        The extractor's spec.
    cache : Path
        Folder of earlier results; the key covers dataset, spec, code and library versions.
    progress : callable
        ``progress(items, total, what)`` passes the items through.
    jobs : int
        Processes; -1 for one a core. The result does not depend on it.

    Returns
    -------
    numpy.ndarray
        float64, shape (n_patches, dim), memory-mapped read-only.
    """
    path = cache / f"{dataset.name}-{_cache_key(dataset, spec)}.npy"
    shape = (len(dataset.patches), build_extractor(spec).dim)
    table = _cached(path, shape)
    if table is None:
        _compute(dataset, spec, path, shape, progress, jobs)
        table = _cached(path, shape)
    if table is None:
        raise ToktError(f"feature cache {path} cannot be read back; is the disk full?")
    return table


def _compute(
    dataset: DatasetVersion,
    spec: dict[str, Any],
    path: Path,
    shape: tuple[int, int],
    progress: Callable[..., Any],
    jobs: int,
) -> None:
    patches, frames, grid = dataset.patches, dataset.frames, dataset.grid
    keys = ["mission", "camera", "frame"]
    stored = {
        key: (dataset.path / "frames" / file, digest)
        for *key_parts, file, digest in frames[[*keys, "file", "digest"]].itertuples(
            index=False, name=None
        )
        for key in [tuple(key_parts)]
    }
    groups = patches.groupby(keys, sort=False).indices
    cells = (patches.row * grid.cols + patches.col).to_numpy()
    tasks = (
        joblib.delayed(_describe)(*stored[key], cells[rows], spec, grid)
        for key, rows in groups.items()
    )
    run = joblib.Parallel(n_jobs=jobs, return_as="generator")
    atomic.remove_partials(path.parent, atomic.ABANDONED_S)
    with atomic.scratch_folder(path) as folder:
        table = np.lib.format.open_memmap(folder / path.name, "w+", np.float64, shape)
        results = progress(run(tasks), len(groups), "features")
        for rows, values in zip(groups.values(), results, strict=True):
            table[rows] = values
        table.flush()
        digest = hashlib.sha256(table.data).hexdigest()
        del table
        atomic.write_text(path.with_suffix(".sha256"), digest)
        (folder / path.name).replace(path)
