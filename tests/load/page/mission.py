"""A long mission out of few pictures: links to them, and labels for every patch."""

from collections.abc import Iterable
from itertools import cycle, islice
from pathlib import Path

from tokt.cli.output import progress
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, Mission
from tokt.labels.record import LabelRecord, utc_now
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import Taxonomy

_STORED_AT_ONCE = 100_000


def copy_frames(mission: Mission, numbers: Iterable[int], target: Path) -> None:
    for number in numbers:
        data, suffix = mission.encoded(number)
        folder = target / "Left"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{mission.name}_L_{number}{suffix}").write_bytes(data)


def link_frames(pictures: Path, target: Path, count: int) -> None:
    """Make a mission of `count` left frames whose files are links to a folder's, over and over."""
    folder = target / "Left"
    folder.mkdir(parents=True)
    for number, file in enumerate(islice(cycle(sorted(pictures.iterdir())), count), 1):
        _link(file.resolve(), folder / f"bench_L_{number}{file.suffix}")


def _link(file: Path, link: Path) -> None:
    try:
        link.symlink_to(file)
    except OSError:
        try:
            link.hardlink_to(file)
        except OSError as error:
            raise ToktError(f"cannot link {link} to {file}: {error.strerror}") from None


def label_all(database: Path, mission: str, frames: int, annotator: str) -> int:
    """Give every patch of a mission a label in a store; how many labels that are."""
    names = Taxonomy.load().names
    time = utc_now()
    cells = [divmod(cell, DEFAULT_GRID.cols) for cell in range(DEFAULT_GRID.n_patches)]
    step = max(1, _STORED_AT_ONCE // len(cells))
    with LabelStore(database) as store:
        starts = range(1, frames + 1, step)
        for first in progress(starts, len(starts), "label every patch"):
            store.add(
                LabelRecord(
                    *(mission, LEFT, frame, DEFAULT_GRID, row, col),
                    *(names[(frame // 7 + row) % len(names)], annotator, time),
                )
                for frame in range(first, min(first + step, frames + 1))
                for row, col in cells
            )
    return frames * len(cells)
