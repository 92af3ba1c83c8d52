"""The whole bench: what it is measured on, all cases in one run, and what is written."""

import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import joblib

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.frames.mission import Mission, open_mission
from tokt.features.kernels.dispatch import KERNELS, LIBRARY, VARIABLE
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.labels.formats.options import Progress
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets.mission_source import labels_of_mission, read_labels
from tokt.training.fitting.presets import DEFAULT_EXTRACTOR, extractor_for
from tokt.training.options import Notice
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission

from .cases import (
    BestFrame,
    Case,
    HaralickKernel,
    LbpKernel,
    MovingFrame,
    Picture,
    WholeFrame,
    textured_frame,
)
from .models import (
    FEATURE_SETS,
    ModelPair,
    TrainingExamples,
    examples_from_labels,
    examples_from_two_images,
    fit_extractor_pair,
)
from .paired_timing import SPREAD_IS, BenchSize, Result, single_thread
from .process_cases import measure_extraction, measure_latency, measure_start
from .report import chart_png
from .stereo_cases import measure_stereo, stereo_input

LABEL_FILE = "labels.csv"
EMBEDDED_FRAMES = 16


FULL = BenchSize(compared=None, timed=12, rounds=8, files=24, tables=5, starts=7, latency=15)
QUICK = BenchSize(compared=8, timed=3, rounds=2, files=3, tables=2, starts=2, latency=2)


@dataclass(frozen=True)
class Bench:
    """Results of one run of the bench."""

    results: list[Result]
    about: dict[str, Any]  # everything else of the JSON object

    def to_json(self) -> dict[str, Any]:
        """The JSON object of ``tokt bench --json``."""
        return {"cases": [case.to_json() for case in self.results], **self.about}


def _examples(mission: Mission, labels: Path | None) -> TrainingExamples:
    """Learn from the label file given, from the one in the mission's folder, or from none."""
    beside = mission.path / LABEL_FILE
    file = labels or (beside if beside.is_file() else None)
    if file is None:
        return examples_from_two_images(mission)
    taxonomy = Taxonomy.load()
    records, _ = labels_of_mission(mission, read_labels([file], taxonomy, GRID), GRID, only=True)
    return examples_from_labels(mission, records, taxonomy)


def measure_in_process(
    mission: Mission,
    models: Sequence[ModelPair],
    best: ModelPair,
    size: BenchSize,
    progress: Progress,
    say: Notice,
) -> tuple[list[Result], int, int]:
    """Kernels and frames: compared on all frames, then timed on a few of them."""
    numbers = mission.frames()
    compared = evenly_spaced(numbers, size.compared or len(numbers))
    kernels: list[Case[Picture]] = [
        LbpKernel("lbp_10_5.kernel", 10, 5),
        LbpKernel("lbp_24_8.kernel", 24, 8),
        HaralickKernel("haralick.kernel"),
    ]
    texture_kernel = HaralickKernel("haralick_texture.kernel")
    frames: list[Case[Picture]] = [
        WholeFrame(*pair) for pair in zip(FEATURE_SETS, models, strict=True)
    ]
    moving = MovingFrame(models[0].bundle)
    frames += [BestFrame(models[-1].bundle, best.bundle), moving]
    textured = Picture(textured_frame())
    texture_kernel.check(textured)
    judged = []
    for number in progress(compared, len(compared), "compare"):
        picture = Picture(mission.read(number))
        if all([case.check(picture) for case in (*kernels, *frames)]):
            judged.append(number)
    if not judged:
        raise ToktError(f"mission {mission.name}: the runtime refuses to judge any of its frames")
    # A refused frame costs the runtime next to nothing: timing it would flatter.
    timed = [Picture(mission.read(number)) for number in evenly_spaced(judged, size.timed)]
    end = numbers.index(judged[-1]) + 1
    neighbours = numbers[max(end - len(timed), 0) : end]
    others = {
        texture_kernel.name: [textured] * len(timed),
        # Points are followed between neighbours only.
        moving.name: [Picture(mission.read(number)) for number in neighbours],
    }
    results = []
    for case in [*kernels, texture_kernel, *frames]:
        say(f"-- {case.name}")
        results.append(case.measure(others.get(case.name, timed), size.rounds))
    say("-- latency")
    results.append(measure_latency(FEATURE_SETS[0], models[0], timed, size.latency))
    return results, len(compared), len(timed)


def _most_obstacles(mission: Mission, models: ModelPair, count: int) -> int:
    """Of some frames the one with the most obstacle patches: the start's verdict says something."""

    def obstacles(number: int) -> int:
        values = models.bundle.decision_values(mission.read(number))
        return int(models.bundle.model.obstacle_patches(values).sum())

    return max(evenly_spaced(mission.frames(), count), key=obstacles)


def _outside(
    mission: Mission, models: Sequence[ModelPair], size: BenchSize, folder: Path, say: Notice
) -> list[Result]:
    """Feature tables from files, and whole processes."""
    files = []
    for number in evenly_spaced(mission.frames(), size.files):
        data, suffix = mission.encoded(number)
        files.append(folder / "files" / f"frame_{number}{suffix}")
        atomic.write_bytes(files[-1], data)
    results = []
    for name, jobs in (("extract.dataset", 1), ("extract.dataset_all_cores", joblib.cpu_count())):
        say(f"-- {name}")
        results.append(measure_extraction(name, files, jobs, size.tables))
    say("-- start")
    frame, suffix = mission.encoded(_most_obstacles(mission, models[0], size.timed))
    results.append(measure_start(models[0], frame, suffix, folder / "start", size.starts))
    return results


def _measure(
    mission: Mission,
    labels: Path | None,
    calibration: StereoCalibration | None,
    size: BenchSize,
    folder: Path,
    progress: Progress,
    say: Notice,
) -> Bench:
    first = mission.read(mission.frames()[0])
    examples = _examples(mission, labels)
    stereo = stereo_input(mission, calibration)
    # Every process started meanwhile uses this one's kernels, or fails, but no others.
    with single_thread(), patch.dict(os.environ, {VARIABLE: KERNELS.name}):
        asked = [(one.name, one.extractor) for one in FEATURE_SETS]
        asked.append(("best", extractor_for(DEFAULT_EXTRACTOR, "best")))
        *models, best = [fit_extractor_pair(*one, examples, first) for one in asked]
        results, compared, timed = measure_in_process(mission, models, best, size, progress, say)
        if stereo.calibration is not None:
            results += measure_stereo(mission, stereo.calibration, size, progress, say)
        results += _outside(mission, models, size, folder, say)
    is_library = KERNELS.name == LIBRARY
    kernels = {"name": KERNELS.name, "why": KERNELS.why, "is_library": is_library}
    height, width = first.shape[:2]
    about = {
        "machine": machine(),
        "kernels": kernels,
        "mission": mission.name,
        "frame_size": f"{width}x{height} {'gray' if first.ndim == 2 else 'colour'}",
        "frames": {"compared": compared, "timed": timed},
        "model": examples.words,
        "stereo": stereo.words,
        "spread_is": SPREAD_IS,
        "exact": all(case.exact for case in results),
    }
    return Bench(results, about)


def run_bench(
    out: Path,
    mission: Path | None,
    labels: Path | None,
    calibration: StereoCalibration | None,
    size: BenchSize,
    progress: Progress,
    say: Notice,
) -> Bench:
    """Measure all cases and write ``bench.json`` and ``bench.png`` into `out`.

    A mission that is None is rendered for it and thrown away. Without a label file, and a
    ``labels.csv`` in the mission's folder, the models learn from two images as in the thesis;
    without a calibration, and a ``calibration.yml`` there, the stereo cases are left out, and the
    result says so. Raises ToktError if the mission or its labels cannot be used, or a process that
    is measured fails.
    """
    if labels is not None and mission is None:
        raise ToktError("--labels goes together with --mission")
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with --out")
    with tempfile.TemporaryDirectory(prefix="tokt-bench-") as name:
        folder = Path(name)
        if mission is None:
            say("-- render a mission")
            simulate_mission(folder / "embedded", n_frames=EMBEDDED_FRAMES, progress=progress)
        opened = open_mission(mission or folder / "embedded")
        found = _measure(opened, labels, calibration, size, folder, progress, say)
    if mission is None:
        found.about["mission"] += " (rendered)"
    text = json.dumps(found.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "bench.json", text + "\n")
    atomic.write_bytes(out / "bench.png", chart_png(found.results, found.about))
    return found
