"""Ceilings: what learners that are never deployed make of the same labels, by the same folds.

Nothing was chosen by what is reported: boosting is as its library has it, the net was fixed.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from sklearn.ensemble import HistGradientBoostingClassifier

from tokt.features.common.arrays import F32, F64, I64
from tokt.training.datasets.dataset import FRAME_KEY, PATCH_KEY, DatasetVersion
from tokt.training.evaluation.metrics import class_metrics, obstacle_metrics
from tokt.training.fitting.classifier import changed_rows

from .learning import Setting, set_up
from .predictions import ComparedModels, ModelPredictions

EPOCHS, BATCH, PATCH_SIZE = 10, 256, (36, 27)  # the net's; width and height of what it sees
_Learner = Callable[[I64, I64], F64]  # rows to learn from, rows to test: their probabilities


def ceilings(
    compared: ComparedModels,
    models: Sequence[ModelPredictions],
    workspace: Path,
    progress: Callable[..., Any],
) -> list[dict[str, Any]]:
    """Gradient boosting on the features of each model, and a small net on the patches' pixels.

    Of held-out comparisons, and those `models` of it that learn from its dataset. Each has learner,
    model (None for the net), and patch (figures) or missing (why there are none).
    """
    dataset, tried = compared.dataset, list[tuple[dict[str, Any], _Learner]]()
    if dataset is None or not models:
        return [{"learner": "any", "model": None, "missing": "there is no dataset to learn from"}]
    for item in models:
        setting = set_up(item, dataset, workspace, progress)
        dives = setting.split.dives(dataset.patches)
        weight = np.ones(len(setting.targets)) if dives is None else dives.weights()
        learner = _boosting(setting, weight, None if dives is None else dives.number)
        tried.append(({"learner": "gradient boosting", "model": item.label}, learner))
    net: dict[str, Any] = {"learner": "small convolutional net on the pixels", "model": None}
    if not dataset.pictured.all():
        net["missing"] = "the dataset has no pictures of some frames"
    elif find_spec("torch"):
        tried.append((net, _net(_pixels(dataset, progress), setting.targets, weight)))
    else:
        net["missing"] = "not installed (pip install torch)"
    # Cut anew: the folds of `set_up` are thinned for a curve of many fits.
    folds = setting.split.cut(dataset.patches, setting.targets)
    every = pd.MultiIndex.from_frame(dataset.patches[PATCH_KEY])
    rows = every.get_indexer(pd.MultiIndex.from_frame(compared.patches[PATCH_KEY]))
    obstacle, targets = np.asarray(dataset.obstacle_flags()), setting.targets[rows]
    for about, learner in tried:
        found = np.full((len(every), len(obstacle)), np.nan)
        for fold in progress(folds, len(folds), f"ceiling: {about['learner']}"):
            found[fold.test] = learner(fold.train, fold.test)
        found = found[rows]
        sides = [found[:, one].max(axis=1, initial=-np.inf) for one in (obstacle, ~obstacle)]
        about["patch"] = {
            **obstacle_metrics(compared.truth, sides[0] - sides[1]),
            **class_metrics(targets, found.argmax(axis=1), dataset.classes()),
        }
    return [*(about for about, _ in tried if about is not net), net]


def _boosting(setting: Setting, weight: F64, dives: I64 | None) -> _Learner:
    """Learns from augmented frames too, with the same weight, where the model does."""
    features, targets, settings = setting.features, setting.targets, setting.settings

    def learn(train: I64, test: I64) -> F64:
        rows, sources, weights = [features[train]], [train], [weight[train]]
        own = None if dives is None else dives[train]
        for table in setting.augmented:
            at, parts = changed_rows(table, train, own, weight[train], settings)
            rows.append(table.features[at])
            sources.append(table.source[at])
            weights.append(settings.change_weight * parts)
        booster = HistGradientBoostingClassifier(random_state=0)
        known = targets[np.concatenate(sources)]
        booster.fit(np.concatenate(rows), known, np.concatenate(weights))
        return np.asarray(booster.predict_proba(features[test]), np.float64)

    return learn


def _pixels(dataset: DatasetVersion, progress: Callable[..., Any]) -> F32:
    """Each patch's gray levels, and these by their own mean and spread: (n, 2, height, width)."""
    found = np.zeros((len(dataset.patches), 2, *PATCH_SIZE[::-1]), np.float32)
    rows_of = dataset.patches.groupby(FRAME_KEY).indices
    place = (dataset.patches.row * dataset.grid.cols + dataset.patches.col).to_numpy()
    keys = list(dataset.frames[FRAME_KEY].itertuples(index=False, name=None))
    for index, key in enumerate(progress(keys, len(keys), "reading pixels")):
        frame = dataset.read_frame(index).astype(np.float32)
        gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        size = dataset.grid.resized(*gray.shape)[::-1]
        cells = dataset.grid.cells(cv2.resize(gray, size, interpolation=cv2.INTER_AREA))
        for row in rows_of.get(key, ()):
            patch = cv2.resize(cells[place[row]], PATCH_SIZE, interpolation=cv2.INTER_AREA)
            found[row] = patch / 64, (patch - patch.mean()) / (patch.std() + 0.1)
    return found


def _net(pixels: F32, targets: I64, weight: F64) -> _Learner:
    """Three convolutions, their mean and maximum; learnt from scratch, mirrored at random."""
    torch: Any = import_module("torch")
    nn, shapes = torch.nn, ((2, 16, 5), (16, 32, 3), (32, 64, 3))

    def learn(train: I64, test: I64) -> F64:
        torch.manual_seed(0)
        rng, layers = np.random.default_rng(0), nn.Sequential()
        for before, after, size in shapes:
            layers.append(nn.Conv2d(before, after, size, 2, size // 2, bias=False))
            layers.extend([nn.BatchNorm2d(after), nn.ReLU()])
        model = nn.ModuleList([layers, nn.Linear(2 * shapes[-1][1], int(targets.max()) + 1)])
        order = [rng.permutation(train) for _ in range(EPOCHS)]
        batches = [rows for one in order for rows in np.array_split(one, -(-len(one) // BATCH))]
        optimizer = torch.optim.AdamW(model.parameters(), 3e-3)
        rate = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=len(batches))

        def values(rows: I64, down: int = 1, across: int = 1) -> Any:
            seen = layers(torch.from_numpy(pixels[rows][:, :, ::down, ::across].copy()))
            return model[1](torch.cat([seen.mean((2, 3)), seen.amax((2, 3))], 1))

        for rows in batches:
            known, weights = torch.from_numpy(targets[rows]), torch.from_numpy(weight[rows])
            found = values(rows, *rng.choice([1, -1], 2).tolist())
            loss = nn.functional.cross_entropy(found, known, reduction="none")
            optimizer.zero_grad()
            (loss * weights).mean().backward()
            optimizer.step()
            rate.step()
        model.eval()
        with torch.no_grad():
            parts = [values(rows) for rows in np.array_split(test, -(-len(test) // BATCH))]
            return np.asarray(torch.softmax(torch.cat(parts), 1).numpy(), np.float64)

    return learn
