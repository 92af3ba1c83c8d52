"""Time and memory of training, and their growth with the number of patches."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from tests.load.report import LEFT, RIGHT, machine_words, table, write_json
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.studies.simulation.scene.rig import FULL_WIDTH
from tokt.training.datasets.splits import BLOCK_FRAMES, FOLDS

from .cost import Cost, watched
from .mission import ScaleMission
from .steps import (
    BUILD,
    EXTRACTOR,
    FIGURES,
    FIT,
    ONE_JOB,
    TRIAL,
    TWO_JOBS,
    cache_folder,
    label_file,
)

_PROCESSES = ((BUILD,), (ONE_JOB,), (TWO_JOBS,), (FIT, FIGURES), (TRIAL,))
_MAX_S = 900.0
"""A cross-validation that would take longer is worked out from its fits instead."""
_BYTES_A_PIXEL = 0.6  # of a noisy frame as JPEG, at most
_KEPT_TWICE = 2.2  # the mission's frames, and the datasets' copies of them

_FEWEST = FOLDS * BLOCK_FRAMES

Progress = Callable[..., Any]


@dataclass(frozen=True)
class ScaleBenchSize:
    """Numbers of frames of the bench of scale.

    Parameters
    ----------
    frames : tuple of int
        The sizes to measure, ascending.
    width : int
        Frame width in pixels.
    story : int
        Different frames; the rest are these again with other noise.
    """

    frames: tuple[int, ...]
    width: int
    story: int

    def up_to(self, frames: int) -> ScaleBenchSize:
        """Each size a tenth of the next, `frames` the largest.

        Raises
        ------
        ToktError
            If these are too few to be split into folds.
        """
        sizes = [frames // part for part in (100, 10, 1) if frames // part >= _FEWEST]
        if not sizes:
            raise ToktError(f"--frames: at least {_FEWEST}, as many as a cross-validation needs")
        return replace(self, frames=tuple(sizes))


FULL = ScaleBenchSize((100, 1000, 10_000), FULL_WIDTH, BLOCK_FRAMES)
QUICK = ScaleBenchSize((100, 200), 360, 5)


@dataclass(frozen=True)
class CostGrowth:
    """One step's cost by number of patches.

    Parameters
    ----------
    step : str
    patches : tuple of int
    costs : tuple of Cost
        One for each number of patches.
    """

    step: str
    patches: tuple[int, ...]
    costs: tuple[Cost, ...]

    @property
    def exponent(self) -> float | None:
        """The p in ``seconds ~ patches ** p``, by least squares; None for a single size."""
        if len(self.patches) < 2:
            return None
        seconds = [cost.seconds for cost in self.costs]
        return float(np.polyfit(np.log(self.patches), np.log(seconds), 1)[0])

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        sizes = []
        for patches, cost in zip(self.patches, self.costs, strict=True):
            values = {"seconds": cost.seconds, "cpu_s": cost.cpu_s, "peak_mb": cost.peak_mb}
            sizes.append({"patches": patches, **values, **cost.facts})
        return {"name": self.step, "exponent": self.exponent, "sizes": sizes}


@dataclass(frozen=True)
class ScaleFound:
    """All that was measured, and on what."""

    growths: Sequence[CostGrowth]
    about: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {"steps": [growth.to_json() for growth in self.growths], **self.about}


def run_scale_bench(
    out: Path, extent: ScaleBenchSize, progress: Progress, say: Callable[[str], None]
) -> ScaleFound:
    """Measure each step of training for growing numbers of patches; write ``scale.json``.

    Parameters
    ----------
    out : Path
        Folder for the result.
    extent : ScaleBenchSize
    progress, say
        As in the other benches.

    Raises
    ------
    ToktError
        If the disk has too little room for it, or a step fails.
    """
    with tempfile.TemporaryDirectory(prefix="tokt-scale-") as name:
        work = Path(name)
        _check_room(work, extent)
        mission = ScaleMission(work, extent.width, extent.story)
        size = mission.write_frames(max(extent.frames), progress)
        costs: list[list[Cost]] = []
        for frames in extent.frames:
            mission.write_labels(label_file(work, frames), frames)
            say(f"-- {frames} frames")
            costs.append(_measure(work, frames, costs[-1] if costs else None, progress))
            shutil.rmtree(cache_folder(work))
    patches = tuple(int(found[0].facts["patches"]) for found in costs)
    growths = [CostGrowth(each[0].step, patches, each) for each in zip(*costs, strict=True)]
    about = {
        "extent": asdict(extent),
        "bytes_a_frame": size / max(extent.frames),
        "extractor": EXTRACTOR,
        "machine": machine(),
    }
    found_all = ScaleFound(growths, about)
    write_json(out / "scale.json", found_all.to_json())
    return found_all


def _measure(work: Path, frames: int, smaller: list[Cost] | None, progress: Progress) -> list[Cost]:
    """The costs of every step for the first so many frames, given those of fewer frames."""
    program = [sys.executable, "-m", "tests.load.scale.steps", str(work), str(frames)]
    costs: list[Cost] = []
    for steps in progress(_PROCESSES, len(_PROCESSES), f"steps for {frames} frames"):
        known = worked_out(smaller, costs) if steps == (TRIAL,) else None
        costs += [known] if known else watched([*program, *steps])
    return costs


def worked_out(smaller: list[Cost] | None, costs: list[Cost]) -> Cost | None:
    """A long cross-validation's cost, were it as many fits long as that of fewer frames."""
    if smaller is None:
        return None
    before = {cost.step: cost for cost in smaller}
    fit = next(cost for cost in costs if cost.step == FIT)
    fits = before[TRIAL].seconds / before[FIT].seconds
    if fit.seconds * fits < _MAX_S:
        return None
    facts = {**before[TRIAL].facts, "worked_out": True}
    return Cost(TRIAL, fit.seconds * fits, fit.cpu_s * fits, fit.peak_mb, facts)


def _check_room(folder: Path, extent: ScaleBenchSize) -> None:
    """Raise ToktError unless frames, datasets and feature tables will fit."""
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


def scale_report(found: ScaleFound) -> list[Table | str]:
    """What was found, to be printed."""
    columns = {"step": LEFT}
    columns |= {f"{patches:,} patches": RIGHT for patches in found.growths[0].patches}
    rows = [
        (
            growth.step.replace("_", " "),
            *map(_cell, growth.costs),
            "" if growth.exponent is None else f"n^{growth.exponent:.2f}",
        )
        for growth in found.growths
    ]
    return [
        table(columns | {"time grows as": RIGHT}, rows),
        f"frames {found.about['extent']['width']} pixels wide, rendered and repeated with other "
        f"noise; features {found.about['extractor']}; cpu s and MB (the most in use at one moment) "
        "of all processes together; ~ worked out from a fit, not measured",
        machine_words(found.about),
    ]


def _cell(cost: Cost) -> str:
    about = "~" if cost.facts.get("worked_out") else ""
    return f"{about}{cost.seconds:.1f} s {about}{cost.cpu_s:6.1f} cpu s {cost.peak_mb:6.0f} MB"
