"""The whole bench: what it is measured on, all cases in one run, and what is written."""

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
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
from tokt.models.bundle.bundle import Bundle
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission

from . import cases, default_run
from . import models as bench_models
from .paired_timing import SPREAD_IS, BenchRequest, BenchSize, Result, single_thread
from .process_cases import measure_extraction, measure_latency, measure_start
from .report import chart_png
from .stereo_cases import measure_stereo, stereo_input
from .video_memory import can_be_measured, measure_video_memory

EMBEDDED_FRAMES = 16
PRESETS = ("best", "water")
"""Whose frames are timed."""


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


def measure_in_process(
    mission: Mission,
    models: Sequence[bench_models.ModelPair],
    presets: Mapping[str, Bundle],
    asked: BenchRequest,
) -> tuple[list[Result], int, int]:
    """Kernels and frames: compared on all frames, then timed on a few of them."""
    numbers = mission.frames()
    compared = evenly_spaced(numbers, asked.size.compared or len(numbers))
    kernels: list[cases.Case[cases.Picture]] = [
        cases.LbpKernel("lbp_10_5.kernel", 10, 5),
        cases.LbpKernel("lbp_24_8.kernel", 24, 8),
        cases.HaralickKernel("haralick.kernel"),
    ]
    texture_kernel = cases.HaralickKernel("haralick_texture.kernel")
    frames: list[cases.Case[cases.Picture]] = [
        cases.WholeFrame(*pair) for pair in zip(bench_models.FEATURE_SETS, models, strict=True)
    ]
    moving = cases.MovingFrame(models[0].bundle)
    frames += [cases.PresetFrame(name, models[-1].bundle, one) for name, one in presets.items()]
    frames.append(moving)
    textured = cases.Picture(cases.textured_frame())
    texture_kernel.check(textured)
    judged = []
    for number in asked.progress(compared, len(compared), "compare"):
        picture = cases.Picture(mission.read(number))
        if all([case.check(picture) for case in (*kernels, *frames)]):
            judged.append(number)
    if not judged:
        raise ToktError(f"mission {mission.name}: the runtime refuses to judge any of its frames")
    # A refused frame costs the runtime next to nothing: timing it would flatter.
    timed = [
        cases.Picture(mission.read(number)) for number in evenly_spaced(judged, asked.size.timed)
    ]
    end = numbers.index(judged[-1]) + 1
    neighbours = numbers[max(end - len(timed), 0) : end]
    # Points are followed between neighbours only.
    in_a_row = [cases.Picture(mission.read(number)) for number in neighbours]
    others = {texture_kernel.name: [textured] * len(timed), moving.name: in_a_row}
    results = []
    for case in [*kernels, texture_kernel, *frames]:
        asked.say(f"-- {case.name}")
        results.append(case.measure(others.get(case.name, timed), asked.size.rounds))
    asked.say(f"-- {default_run.NAME}")
    results.append(default_run.measure_default_run(presets["best"], in_a_row, asked.size.rounds))
    asked.say("-- latency")
    results.append(
        measure_latency(bench_models.FEATURE_SETS[0], models[0], timed, asked.size.latency)
    )
    return results, len(compared), len(timed)


def _most_obstacles(mission: Mission, models: bench_models.ModelPair, count: int) -> int:
    """Of some frames the one with the most obstacle patches: the start's verdict says something."""

    def obstacles(number: int) -> int:
        values = models.bundle.decision_values(mission.read(number))
        return int(models.bundle.model.obstacle_patches(values).sum())

    return max(evenly_spaced(mission.frames(), count), key=obstacles)


def _outside(
    mission: Mission, models: Sequence[bench_models.ModelPair], asked: BenchRequest, folder: Path
) -> list[Result]:
    """Feature tables from files, and whole processes."""
    files = []
    for number in evenly_spaced(mission.frames(), asked.size.files):
        data, suffix = mission.encoded(number)
        files.append(folder / "files" / f"frame_{number}{suffix}")
        atomic.write_bytes(files[-1], data)
    results = []
    for name, jobs in (("extract.dataset", 1), ("extract.dataset_all_cores", joblib.cpu_count())):
        asked.say(f"-- {name}")
        results.append(measure_extraction(name, files, jobs, asked.size.tables))
    asked.say("-- start")
    frame, suffix = mission.encoded(_most_obstacles(mission, models[0], asked.size.timed))
    results.append(measure_start(models[0], frame, suffix, folder / "start", asked.size.starts))
    return results


def _video_memory(
    mission: Mission, model: Bundle, asked: BenchRequest, folder: Path
) -> dict[str, float] | None:
    """Memory of a run with video in; None where it cannot be measured, or frames are gray."""
    pictures = [mission.read(number) for number in evenly_spaced(mission.frames(), 8)]
    if not can_be_measured() or pictures[0].ndim == 2:
        return None
    asked.say("-- memory with video in")
    return measure_video_memory(model, pictures, folder / "video", asked.size.files)


def _measure(mission: Mission, asked: BenchRequest, folder: Path) -> Bench:
    first = mission.read(mission.frames()[0])
    examples = bench_models.learnt_examples(mission, asked.labels)
    stereo = stereo_input(mission, asked.calibration)
    # Every process started meanwhile uses this one's kernels, or fails, but no others.
    with single_thread(), patch.dict(os.environ, {VARIABLE: KERNELS.name}):
        models = [
            bench_models.fit_extractor_pair(one.name, one.extractor, examples, first)
            for one in bench_models.FEATURE_SETS
        ]
        presets = {name: bench_models.fit_preset_bundle(name, examples, first) for name in PRESETS}
        results, compared, timed = measure_in_process(mission, models, presets, asked)
        if stereo.calibration is not None:
            results += measure_stereo(mission, stereo.calibration, asked)
        results += _outside(mission, models, asked, folder)
        video_mb = _video_memory(mission, presets["best"], asked, folder)
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
        "video_mb": video_mb,
        "spread_is": SPREAD_IS,
        "exact": all(case.exact for case in results),
    }
    return Bench(results, about)


def run_bench(out: Path, asked: BenchRequest) -> Bench:
    """Measure all cases and write ``bench.json`` and ``bench.png`` into `out`.

    A mission that is None is rendered for it and thrown away. Without a label file, and a
    ``labels.csv`` in the mission's folder, the models learn from two images as in the thesis;
    without a calibration, and a ``calibration.yml`` there, the stereo cases are left out, and the
    result says so. Raises ToktError if the mission or its labels cannot be used, or a process that
    is measured fails.
    """
    if asked.labels is not None and asked.mission is None:
        raise ToktError("--labels goes together with --mission")
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with --out")
    with tempfile.TemporaryDirectory(prefix="tokt-bench-") as name:
        folder = Path(name)
        if asked.mission is None:
            asked.say("-- render a mission")
            simulate_mission(folder / "embedded", n_frames=EMBEDDED_FRAMES, progress=asked.progress)
        opened = open_mission(asked.mission or folder / "embedded")
        found = _measure(opened, asked, folder)
    if asked.mission is None:
        found.about["mission"] += " (rendered)"
    text = json.dumps(found.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "bench.json", text + "\n")
    atomic.write_bytes(out / "bench.png", chart_png(found.results, found.about))
    return found
