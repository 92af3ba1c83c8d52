"""Image files to a table of features: on one core and on all, as training computes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import joblib
import numpy as np
from numpy.typing import NDArray

from tokt.features.extractors.extractor import Haralick, Join, Lbp, build_extractor
from tokt.features.frames.image_file import read_image
from tokt.studies.baselines.library_texture import all_haralick, all_lbp_10_5
from tokt.studies.baselines.thesis_texture import GRID, haralick_directions, resized_gray

from .frames import Picture
from .haralick_agreement import HaralickAgreement
from .paired_timing import BASELINE, FLOOR, OURS, Result, in_turns, result

_LBP = Lbp(10, 5, "patch")
_EXTRACTOR = Join([_LBP, Haralick(ignore_zeros=True)])
FeatureFile = Callable[[Path], NDArray[np.float64]]


def library_features(file: Path) -> NDArray[np.float64]:
    """LBP (10, 5) and Haralick of one image file through the libraries."""
    cv2.setNumThreads(1)
    gray = resized_gray(read_image(file))
    return np.hstack([all_lbp_10_5(gray), all_haralick(gray)])


def tokt_features(file: Path) -> NDArray[np.float64]:
    """The same as `tokt.training.datasets.feature_cache` has it computed."""
    cv2.setNumThreads(1)
    return build_extractor(_EXTRACTOR.spec).describe(read_image(file), GRID)


def _decode(file: Path) -> int:
    cv2.setNumThreads(1)
    return read_image(file).size


def _agree(files: Sequence[Path], ours: list[Any], theirs: list[Any]) -> bool:
    """Whether LBP is the same and Haralick agrees with mahotas's."""
    agreement = HaralickAgreement()
    for file, mine, other in zip(files, ours, theirs, strict=True):
        if not np.array_equal(mine[:, : _LBP.dim], other[:, : _LBP.dim]):
            return False
        for row, patch in zip(mine, Picture(read_image(file)).patches, strict=True):
            agreement.add(row[_LBP.dim :], haralick_directions(patch, ignore_zeros=True))
    return agreement.agree


def measure_extraction(name: str, files: Sequence[Path], jobs: int, repetitions: int) -> Result:
    """Time the making of a feature table; the times are of one image file.

    Parameters
    ----------
    name : str
    files : sequence of Path
    jobs : int
        Processes, started and warm before the first is timed.
    repetitions : int
        How often the whole table is made.
    """

    def run(function: Callable[[Path], Any], chosen: Sequence[Path]) -> list[Any]:
        tasks = (joblib.delayed(function)(file) for file in chosen)
        return list(joblib.Parallel(n_jobs=jobs)(tasks))

    exact = _agree(files, run(tokt_features, files), run(library_features, files))
    times = in_turns(
        {
            BASELINE: lambda chosen: run(library_features, chosen),
            OURS: lambda chosen: run(tokt_features, chosen),
            FLOOR: lambda chosen: run(_decode, chosen),
        },
        [files],
        repetitions,
    )
    a_file = {key: values / len(files) for key, values in times.items()}
    pace = {key: GRID.n_patches / float(np.median(values)) for key, values in a_file.items()}
    extras = {
        "of": "one image file to 100 rows of LBP (10,5) and Haralick",
        "floor_is": "reading and decoding alone, in as many processes",
        "files": len(files),
        "processes": jobs,
        "baseline_patches_per_s": pace[BASELINE],
        "ours_patches_per_s": pace[OURS],
    }
    return result(name, a_file, exact, extras)
