"""The dataset that a bundle carries, so that training can go on from its model anywhere.

It is a zip of a dataset's files, whose frames are rows of features (`frame_rows`), and of
``parameters.json``, the parameters that the model was trained with.
"""

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common import atomic
from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle, unzip, zip_bytes
from tokt.training.datasets.changed_patches import ChangedPatches, stored_rows
from tokt.training.datasets.dataset import (
    FRAME_KEY,
    HASH_CHARS,
    PATCH_KEY,
    DatasetPlan,
    DatasetVersion,
    FrameSource,
    publish_dataset,
)
from tokt.training.datasets.frame_rows import SUFFIX as ROWS
from tokt.training.datasets.frame_rows import FrameRows, rows_file
from tokt.training.evaluation.frame_scores import frame_table

from .whole_frames import WholeFrames

_PARAMETERS = "parameters.json"
_TABLES = ("dataset.json", "patches.parquet", "frames.parquet")
_NAME = re.compile(r"[\w-][\w.-]*")
_FILE = re.compile(r"frames/[0-9a-f]{64}\.rows")


def plan_of_rows(
    dataset: DatasetVersion,
    name: str,
    spec: dict[str, Any],
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
    spec, changes
        The extractor's spec, and the name of the random changes.
    features : array of float64, shape (n_frames * n_patches, dim)
        As `cached_features` has those of whole frames.
    changed : ChangedPatches
        Of the same dataset.
    frames_a_dive : int
        So many frames of each dive are kept at most, evenly spread.
    """
    whole, keys = WholeFrames.of(dataset, features), frame_table(dataset).keys
    listed = dataset.frames.set_index(FRAME_KEY)
    sources: list[FrameSource] = []
    for _, numbers in keys.groupby("mission").groups.items():
        count = min(len(numbers), frames_a_dive)
        kept = numbers[np.linspace(0, len(numbers) - 1, count).round().astype(int)].tolist()
        rows = []
        for frame in kept:
            about = listed.loc[tuple(keys.loc[frame, FRAME_KEY])]
            mine = np.flatnonzero(whole.frame == frame)
            stored = stored_rows(changed, mine, whole.cell[mine])
            size = int(about.height), int(about.width)
            rows.append(FrameRows(about.digest, *size, features[whole.at[frame]], *stored))
        file = rows_file(rows, spec, changes)
        for frame, one in zip(kept, rows, strict=True):
            mission, camera, number, group = keys.loc[frame]
            load = partial(_encoded, file)
            sources.append(FrameSource(mission, camera, number, group, load, one.digest))
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
    )


def _encoded(file: bytes) -> tuple[bytes, str]:
    return file, ROWS


@dataclass(frozen=True)
class CarriedDataset:
    """A dataset that came with a bundle, and what its model was trained with."""

    dataset: DatasetVersion
    parameters: Mapping[str, str]  # as a run's


def carried_bytes(dataset: DatasetVersion, parameters: Mapping[str, object]) -> bytes:
    """Return a dataset as a bundle carries it; ToktError if it has pictures."""
    if dataset.pictured.any():
        raise ToktError(f"dataset {dataset.label} has pictures, which no bundle carries")
    files = (dataset.path / name for name in _TABLES)
    rows = sorted((dataset.path / "frames").iterdir())
    texts = {name: str(value) for name, value in parameters.items()}
    return zip_bytes(
        {
            **{path.name: path.read_bytes() for path in files},
            **{f"frames/{path.name}": path.read_bytes() for path in rows},
            _PARAMETERS: json.dumps(texts, indent=1, sort_keys=True).encode(),
        }
    )


def install_carried(bundle: Bundle, datasets: Path) -> CarriedDataset:
    """Write the dataset that a bundle carries into a workspace, if it is not there yet.

    Raises ToktError if the bundle carries none, or not what it should.
    """
    where = f"model {bundle.label}: its dataset"
    if bundle.dataset is None:
        raise ToktError(f"model {bundle.label} carries no dataset to go on from")
    members = unzip(bundle.dataset, where)
    try:
        parameters = json.loads(members.pop(_PARAMETERS))
        info = json.loads(members["dataset.json"])
        name = str(info["name"])
        if not isinstance(parameters, dict):
            raise TypeError
    except (KeyError, ValueError, TypeError):
        raise ToktError(f"{where} is damaged") from None
    if any(member not in _TABLES and not _FILE.fullmatch(member) for member in members):
        raise ToktError(f"{where} has files of other kinds")
    if not _NAME.fullmatch(name):
        raise ToktError(f"{where} is damaged")
    atomic.remove_partials(datasets, atomic.ABANDONED_S)
    home = datasets / name
    with atomic.scratch_folder(home) as folder:
        (folder / "frames").mkdir()
        for member, data in members.items():
            (folder / member).write_bytes(data)
        found = DatasetVersion(folder)
        found.check()  # the name of its folder is that of its content
        there = home / found.hash[:HASH_CHARS]
        if any(not (there / member).is_file() or (there / member).read_bytes() != data
               for member, data in members.items() if member != "dataset.json"):  # fmt: skip
            shutil.rmtree(there, ignore_errors=True)
        return CarriedDataset(publish_dataset(folder, home, found.hash), parameters)
