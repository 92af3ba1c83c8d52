"""The model that flies in the closed loop where none is given: trained on rendered missions.

Their seeds are none of the closed loop's: every frame that the vehicle sees is one that the model
has not learnt from. Obstacles it knows from `tokt simulate`'s renderer alone, open water from the
loop's own as well (`write_drift`); both draw water, lamp, snow, noise and towers from the same
distributions.
"""

import tempfile
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import cv2
import numpy as np

from tokt.features.common import atomic
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.options import Progress
from tokt.labels.taxonomy import Taxonomy
from tokt.models.bundle.bundle import Bundle
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import write_dataset
from tokt.training.datasets.folds import EMBARGO_FRAMES, FOLDS
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions, read_labels
from tokt.training.datasets.split import Split
from tokt.training.fitting.choose_operating_point import FalseStatusTarget
from tokt.training.fitting.presets import extractor_for, settings_named
from tokt.training.fitting.tracking import log_and_register
from tokt.training.fitting.train import TrainRequest, fit_and_measure
from tokt.training.options import Notice
from tokt_studies.simulation.loop.autopilot import STEP_S
from tokt_studies.simulation.loop.flight import STEPS_A_FRAME
from tokt_studies.simulation.rendering.patch_labels import OCEAN, labels_csv
from tokt_studies.simulation.rendering.stereo_renderer import StereoRenderer
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt_studies.simulation.scene.closed_loop_world import World
from tokt_studies.simulation.scene.rig import SyntheticRig
from tokt_studies.simulation.scene.water import Water

NAME = "closed-loop"
EXTRACTOR, PRESET = "haralick", "best"
SEEDS = (900_001, 900_002, 900_003, 900_004, 900_005, 900_006)
"""Of the missions learnt from; the closed loop's runs are numbered below."""
FRAMES = 100
DRIFT_SEEDS = (900_101, 900_102, 900_103, 900_104, 900_105, 900_106, 900_107, 900_108)
DRIFT_FRAMES = 60
"""Of the open water learnt from."""
DRIFT_SNOW = (1, 2, 1, 4)
"""Times the snow of the mission, in one sequence after the other."""
FALSE_STATUS_RATE = 1e-5
"""An ocean frame's: a run in empty water has some 120 frames, and one in a hundred may alarm."""


def train_default_model(
    out: Path, width: int, progress: Progress, say: Notice, jobs: int
) -> Bundle:
    """Render missions of a frame width in pixels, train on them, and write the bundle to a file.

    `jobs` are processes for cross-validation; -1 for all cores.
    """
    count = len(SEEDS) + len(DRIFT_SEEDS)
    say(f"-- train a model on {count} rendered missions (--model FILE spares it)")
    taxonomy = Taxonomy.load()
    with tempfile.TemporaryDirectory(prefix="tokt-closed-loop-") as name:
        folder = Path(name)
        missions = [folder / f"rendered-{seed}" for seed in SEEDS]
        for mission, seed in zip(missions, SEEDS, strict=True):
            simulate_mission(mission, seed=seed, n_frames=FRAMES, width=width)
        for seed, snow in zip(DRIFT_SEEDS, cycle(DRIFT_SNOW)):
            missions.append(folder / f"open-water-{seed}")
            write_drift(missions[-1], seed, DRIFT_FRAMES, width, snow)
        labelled = []
        for mission in missions:
            records = read_labels([mission / "labels.csv"], taxonomy, DEFAULT_GRID)
            labelled.append(LabelledMission(open_mission(mission), records))
        plan, _ = plan_from_missions(NAME, "binary", labelled, taxonomy)
        dataset = write_dataset(plan, folder / "datasets", progress)
        extractor, settings = extractor_for(EXTRACTOR, PRESET), settings_named(PRESET)
        split, target = Split(FOLDS, EMBARGO_FRAMES), FalseStatusTarget(FALSE_STATUS_RATE)
        request = TrainRequest(dataset, NAME, extractor, EXTRACTOR, settings, split, target=target)
        registry = Registry(folder / "workspace", create=True, own=True)
        log_and_register(fit_and_measure(request, folder / "cache", progress, jobs), registry)
        bundle = registry.bundle(NAME)
    atomic.write_bytes(out, bundle.data)
    return bundle


WAYS_M_S = ((0.0, 0.0, 0.6), (0.35, 0.0, 0.0), (0.02, 0.01, 0.02), (-0.1, 0.0, 0.2))
"""Velocities east, down and north, one after the other: transit, sideways, hovering, in between."""
_TURN_RAD_S = 0.02


def write_drift(folder: Path, seed: int, frames: int, width: int, snow: int = 1) -> None:
    """Render one sequence as a mission of left frames, all of its patches labelled ocean.

    The new folder's name is the mission's; the seed is that of water, rig, snow and noise; there
    is `snow` times as much snow as the seed has.
    """
    water, rig = (np.random.default_rng([seed, part]) for part in range(2))
    drawn = Water.draw(water)
    drawn = replace(drawn, snow_per_frame=snow * drawn.snow_per_frame)
    renderer = StereoRenderer(World(drawn, seed=seed), SyntheticRig(rig, width), seed)
    (folder / "Left").mkdir(parents=True)
    place, step_s = np.zeros(3), STEP_S * STEPS_A_FRAME
    for index in range(frames):
        velocity = np.array(WAYS_M_S[index * len(WAYS_M_S) // frames])
        t_s = index * step_s
        frame = renderer.left(t_s, place, _TURN_RAD_S * t_s, velocity)
        cv2.imwrite(str(folder / "Left" / f"drift_L_{index + 1}.png"), frame)
        place = place + step_s * velocity
    ocean = [OCEAN] * DEFAULT_GRID.n_patches
    labels = labels_csv(folder.name, ((n, ocean) for n in range(1, frames + 1)))
    (folder / "labels.csv").write_bytes(labels)
