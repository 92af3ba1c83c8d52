"""The dataset that a bundle carries, so that training can go on from its model anywhere.

It is a zip of a dataset's files, whose frames are rows of features (`frame_rows`), and of
``parameters.json``, the parameters that the model was trained with.
"""

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle, unzip, zip_bytes
from tokt.training.datasets.dataset import (
    HASH_CHARS,
    DatasetVersion,
    check_dataset_name,
    publish_dataset,
)

_PARAMETERS = "parameters.json"
_TABLES = ("dataset.json", "patches.parquet", "frames.parquet")
_FILE = re.compile(r"frames/[0-9a-f]{64}\.rows")


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
        parameters = dict(json.loads(members.pop(_PARAMETERS)))
    except (KeyError, ValueError, TypeError):
        raise ToktError(f"{where} is damaged") from None
    if any(member not in _TABLES and not _FILE.fullmatch(member) for member in members):
        raise ToktError(f"{where} has files of other kinds")
    atomic.remove_partials(datasets, atomic.ABANDONED_S)
    with atomic.scratch_folder(datasets / "carried") as folder:
        (folder / "frames").mkdir()
        for member, data in members.items():
            (folder / member).write_bytes(data)
        found = DatasetVersion(folder)
        found.check()
        check_dataset_name(found.name)
        home = datasets / found.name
        there = home / found.hash[:HASH_CHARS]
        # Its sites may have been added to since; a file that is lost or damaged is made anew.
        kept = {member: data for member, data in members.items() if member != "dataset.json"}
        if any(not _holds(there / member, data) for member, data in kept.items()):
            shutil.rmtree(there, ignore_errors=True)
        return CarriedDataset(publish_dataset(folder, home, found.hash), parameters)


def _holds(path: Path, data: bytes) -> bool:
    return path.is_file() and path.read_bytes() == data
