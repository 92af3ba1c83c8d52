"""Time and memory of training, and their growth with the number of patches."""

import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from tests.load.report import Found, machine_words, table
from tokt.cli.output import progress
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.common.terminal import say
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.training.datasets.folds import BLOCK_FRAMES, FOLDS

from .cost import Cost, watched
from .mission import ScaleMission
from .steps import BUILD, EXTRACTOR, FIT, ONE_JOB, TRAINING, TWO_JOBS

FULL_WIDTH = 1360  # pixels, of the mission camera
_PROCESSES = ((BUILD,), (ONE_JOB,), (TWO_JOBS,), (FIT,), (TRAINING,))
_BYTES_A_PIXEL = 0.6  # of a noisy frame as JPEG, at most
_KEPT_TWICE = 2.2  # the mission's frames, and the datasets' copies of them

_FEWEST = FOLDS * BLOCK_FRAMES


@dataclass(frozen=True)
class ScaleBenchSize:
    frames: tuple[int, ...]  # the sizes to measure, ascending
    width: int  # frame width in pixels
    story: int  # different frames; the rest are these again with other noise

    def up_to(self, frames: int) -> "ScaleBenchSize":
        """Each size a tenth of the next, `frames` the largest.

        Raises ToktError if these are too few to be split into folds.
        """
        sizes = [frames // part for part in (100, 10, 1) if frames // part >= _FEWEST]
        if not sizes:
            raise ToktError(f"--frames: at least {_FEWEST}, as many as a cross-validation needs")
        return replace(self, frames=tuple(sizes))


FULL = ScaleBenchSize((100, 1000, 10_000), FULL_WIDTH, BLOCK_FRAMES)
QUICK = ScaleBenchSize((100, 200), 360, 5)


def run_scale_bench(extent: ScaleBenchSize) -> Found:
    """Measure each step of training for growing numbers of patches.

    Raises ToktError if the disk has too little room for it, or a step fails.
    """
    measured: list[dict[str, Cost]] = []
    with tempfile.TemporaryDirectory(prefix="tokt-scale-") as name:
        work = Path(name)
        _check_room(work, extent)
        mission = ScaleMission(work, extent.width, extent.story)
        size = mission.write_frames(max(extent.frames))
        for frames in extent.frames:
            folder = work / str(frames)
            folder.mkdir()
            say(f"-- {frames} frames")
            measured.append(_measure(folder, mission.path, frames))
            shutil.rmtree(folder)
    patches = [costs[BUILD]["patches"] for costs in measured]
    steps = []
    for name in measured[0]:
        costs = [each[name] for each in measured]
        sizes = [{"patches": count, **cost} for count, cost in zip(patches, costs, strict=True)]
        growth = exponent(patches, [cost["seconds"] for cost in costs])
        steps.append({"name": name, "exponent": growth, "sizes": sizes})
    found = {
        "steps": steps,
        "extent": asdict(extent),
        "bytes_a_frame": size / max(extent.frames),
        "extractor": EXTRACTOR,
        "machine": machine(),
    }
    return Found("scale", found, scale_report(found))


def _measure(folder: Path, dives: Path, frames: int) -> dict[str, Cost]:
    program = [sys.executable, "-m", "tests.load.scale.steps", str(folder), str(dives), str(frames)]
    costs: dict[str, Cost] = {}
    for steps in progress(_PROCESSES, len(_PROCESSES), f"steps for {frames} frames"):
        costs |= watched([*program, *steps])
        say(f"   {', '.join(_cell(costs[step]) for step in steps)}")
    return costs


def exponent(patches: Sequence[int], seconds: Sequence[float]) -> float | None:
    """The p in ``seconds ~ patches ** p``, by least squares; None for a single size."""
    if len(patches) < 2:
        return None
    return float(np.polyfit(np.log(patches), np.log(seconds), 1)[0])


def _check_room(folder: Path, extent: ScaleBenchSize) -> None:
    largest = max(extent.frames)
    pixels = extent.width**2 * 3 / 4
    tables = 2 * largest * DEFAULT_GRID.n_patches * extractor_named(EXTRACTOR).dim * 8
    needed = largest * pixels * _BYTES_A_PIXEL * _KEPT_TWICE + tables
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise ToktError(
            f"measuring {largest} frames needs about {needed / 1e9:.1f} GB in {folder.parent}, "
            f"where {free / 1e9:.1f} GB are free; ask for fewer --frames or set TMPDIR"
        )


def scale_report(found: Mapping[str, Any]) -> list[Table | str]:
    sizes = [f"{size['patches']:,} patches" for size in found["steps"][0]["sizes"]]
    rows = [
        (
            step["name"].replace("_", " "),
            *map(_cell, step["sizes"]),
            "" if step["exponent"] is None else f"n^{step['exponent']:.2f}",
        )
        for step in found["steps"]
    ]
    return [
        table(("step", *sizes, "time grows as"), rows),
        f"frames {found['extent']['width']} pixels wide, rendered and repeated with other "
        f"noise, 100 a dive; features {found['extractor']}; cpu s and MB (the most in use at one "
        "moment) of all processes together; in brackets without pages of files that are mapped",
        machine_words(found),
    ]


def _cell(cost: Cost) -> str:
    memory = f"{cost['peak_mb']:6.0f} ({cost['own_mb']:.0f}) MB"
    return f"{cost['seconds']:.1f} s {cost['cpu_s']:6.1f} cpu s {memory}"
