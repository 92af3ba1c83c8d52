"""The model that flies in the closed loop where none is given: trained on rendered missions.

Their seeds are none of the closed loop's: every frame that the vehicle sees is one that the model
has not learnt from. Obstacles it knows from `tokt simulate`'s renderer alone, open water from the
loop's own as well (`drifts`); both draw water, lamp, snow, noise and towers from the same
distributions.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...features import atomic
from ...labels.label_csv import read_label_csv
from ...labels.synthetic.mission import simulate_mission
from ...labels.taxonomy import Taxonomy
from ...models.bundle import Bundle
from ...models.registry import Registry
from ..cross_validation import Split
from ..dataset import build_dataset
from ..mission_source import plan_from_missions
from ..operating_point import Target
from ..presets import extractor_for, settings_named
from ..splits import EMBARGO_FRAMES, FOLDS
from ..tracking import log_and_register
from ..train import TrainRequest, train
from .drifts import write_drift

NAME = "closed-loop"
EXTRACTOR, PRESET = "haralick", "best"
SEEDS = (900_001, 900_002, 900_003, 900_004, 900_005, 900_006)
"""Of the missions learnt from; the closed loop's runs are numbered below."""
FRAMES = 100
DRIFT_SEEDS = (900_101, 900_102, 900_103, 900_104, 900_105, 900_106, 900_107, 900_108)
DRIFT_FRAMES = 60
"""Of the open water learnt from."""
FALSE_STATUS_RATE = 1e-5
"""An ocean frame's: a run in empty water has some 120 frames, and one in a hundred may alarm."""

Progress = Callable[..., Any]
Say = Callable[[str], None]


def train_default_model(
    out: Path, width: int, progress: Progress, say: Say, jobs: int = -1
) -> Bundle:
    """Render missions, train on them, and write the bundle to `out`.

    Parameters
    ----------
    out : Path
        The file.
    width : int
        Of the frames, in pixels.
    progress, say : callable
        Where progress and remarks go.
    jobs : int
        Processes for cross-validation; -1 for all cores.

    Returns
    -------
    Bundle
    """
    count = len(SEEDS) + len(DRIFT_SEEDS)
    say(f"-- train a model on {count} rendered missions (--model FILE spares it)")
    taxonomy = Taxonomy.load()
    with tempfile.TemporaryDirectory(prefix="tokt-closed-loop-") as name:
        folder = Path(name)
        missions = [folder / f"rendered-{seed}" for seed in SEEDS]
        for mission, seed in zip(missions, SEEDS, strict=True):
            simulate_mission(mission, seed=seed, n_frames=FRAMES, width=width)
        for seed in DRIFT_SEEDS:
            missions.append(folder / f"open-water-{seed}")
            write_drift(missions[-1], seed, DRIFT_FRAMES, width)
        records = [
            record
            for mission in missions
            for record in read_label_csv(mission / "labels.csv", taxonomy)
        ]
        plan, _ = plan_from_missions(NAME, "binary", missions, records, taxonomy)
        dataset = build_dataset(plan, folder / "datasets", progress)
        request = TrainRequest(
            dataset,
            NAME,
            extractor_for(EXTRACTOR, PRESET),
            EXTRACTOR,
            settings_named(PRESET),
            Split(FOLDS, EMBARGO_FRAMES),
            target=Target(FALSE_STATUS_RATE),
        )
        registry = Registry(folder / "workspace", create=True, own=True)
        log_and_register(train(request, folder / "cache", progress, jobs), registry)
        bundle = registry.bundle(NAME)
    atomic.write_bytes(out, bundle.data)
    return bundle
