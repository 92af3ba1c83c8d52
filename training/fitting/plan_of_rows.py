"""The plan of a dataset that holds rows of features in place of another one's pictures."""

from functools import partial

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64
from tokt.features.extractors.textures import Extractor
from tokt.training.datasets.changed_patches import ChangedPatches, stored_rows
from tokt.training.datasets.dataset import (
    FRAME_KEY,
    PATCH_KEY,
    DatasetPlan,
    DatasetVersion,
    FrameSource,
)
from tokt.training.datasets.frame_rows import SUFFIX as ROWS
from tokt.training.datasets.frame_rows import FrameRows, rows_file
from tokt.training.evaluation.frame_scores import frame_table

from .whole_frames import WholeFrames


def plan_of_rows(
    dataset: DatasetVersion,
    name: str,
    extractor: Extractor,
    changes: str,
    features: F64,
    changed: ChangedPatches,
    frames_a_dive: int,
) -> DatasetPlan:
    """Plan a dataset that holds rows of features of some frames in place of their pictures.

    Parameters
    ----------
    dataset : DatasetVersion
        The one with the pictures; all of its missions have one grid.
    name : str
        What the new one is called.
    extractor : Extractor
    changes : str
        The name of the random changes.
    features : array of float64, shape (n_frames * n_patches, dim)
        As `cached_features` has those of whole frames.
    changed : ChangedPatches
        Of the same dataset.
    frames_a_dive : int
        So many frames of each dive are kept at most, evenly spread.
    """
    whole = WholeFrames.of(dataset, features, extractor)
    keys = frame_table(dataset).keys
    listed = dataset.frames.set_index(FRAME_KEY)
    sources: list[FrameSource] = []
    for _, numbers in keys.groupby("mission").groups.items():
        count = min(len(numbers), frames_a_dive)
        kept = numbers[np.linspace(0, len(numbers) - 1, count).round().astype(int)].tolist()
        rows = []
        for frame in kept:
            mine = np.flatnonzero(whole.frame == frame)
            stored = stored_rows(changed, mine, whole.cell[mine])
            digest = listed.loc[tuple(keys.loc[frame, FRAME_KEY])].digest
            rows.append(FrameRows(digest, features[whole.at[frame]], *stored))
        file = rows_file(rows, extractor.spec, changes)
        for frame, one in zip(kept, rows, strict=True):
            mission, camera, number, group, position = keys.loc[frame]
            about = listed.loc[mission, camera, number]
            known = one.digest, int(about.height), int(about.width)
            load = partial(_encoded, file)
            where = int(position), str(about["name"])
            sources.append(FrameSource(mission, camera, number, group, load, known, *where))
    kept_keys = pd.DataFrame([(one.mission, one.camera, one.frame) for one in sources])
    patches = dataset.patches.merge(kept_keys.set_axis(FRAME_KEY, axis=1), on=FRAME_KEY)
    return DatasetPlan(
        name,
        dataset.task,
        dataset.grid,
        dataset.taxonomy,
        sources,
        patches[[*PATCH_KEY, "label"]],
        dataset.info["unsure_left_out"],
        dataset.block_frames,
        [*dataset.info["sources"], f"at most {frames_a_dive} frames a dive, as rows of features"],
        dataset.sites,
        single_pictures=dataset.info.get("single_pictures", {}),
        scene_frames=dataset.info.get("scene_frames", {}),
    )


def _encoded(file: bytes) -> tuple[bytes, str]:
    return file, ROWS
