"""The content of a trained model's bundle, and the recipe that the registry keeps beside it."""

import subprocess
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import mlflow
import numpy as np
import pandas as pd

from tokt import __version__
from tokt.features.common.arrays import U8
from tokt.features.frames.mission import format_frames
from tokt.features.kernels.dispatch import KERNELS
from tokt.models.bundle.bundle import BundleContent, Golden
from tokt.models.registry.registry import RECIPE_VERSION
from tokt.models.sight import SightLimits, joined_sight, sight_from_json, sight_to_json
from tokt.training.datasets.dataset import FRAME_KEY, DatasetVersion

from .classifier import decision_values
from .train import Trained

_LIBRARIES = ("numpy", "opencv-python-headless", "scikit-learn")
_MLFLOW = f"mlflow {mlflow.__version__}"  # of mlflow or mlflow-skinny


def code_version() -> str:
    """The version of tokt, with the git commit where it runs from a checkout."""
    folder = Path(__file__).resolve().parents[2]  # of a checkout: src/tokt holds links
    if not (folder / ".git").exists():
        return __version__  # git would describe whatever repository the install happens to be in
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--exclude=*"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return __version__
    return f"{__version__}+g{found.stdout.strip()}"


def _golden_frames(dataset: DatasetVersion) -> list[U8]:
    """Return two pictures: the one with most obstacle patches, and the clearest one."""
    patches = dataset.patches.assign(obstacle=dataset.obstacles())
    counts = patches.groupby(FRAME_KEY).obstacle.agg(["sum", "size"])
    pictured = dataset.frames[dataset.pictured]
    listed = counts.loc[pd.MultiIndex.from_frame(pictured[FRAME_KEY])].set_index(pictured.index)
    most = int(listed["sum"].idxmax())
    clearest = int((listed["size"] - listed["sum"]).idxmax())
    return [dataset.read_frame(row) for row in sorted({most, clearest})]


def golden_of(trained: Trained, frames: Sequence[U8]) -> Golden:
    """Return golden frames with what *scikit-learn's* pipeline says of them, not folded weights."""
    dataset = trained.request.dataset
    files, values = [], []
    for image in frames:
        files.append(cv2.imencode(".png", image)[1].tobytes())
        described = trained.request.extractor.describe(image, dataset.grid)
        values.append(decision_values(trained.pipeline, described))
    obstacle = np.stack([trained.model.obstacle_patches(value) for value in values])
    return Golden(tuple(files), np.stack(values), obstacle)


def _sight(trained: Trained) -> tuple[SightLimits, ...]:
    """Return what training frames show at least.

    Of frames without a picture it is what the model that they come with says.
    """
    return joined_sight(trained.request.known_sight, trained.request.dataset.sight)


def _frame_sizes(trained: Trained) -> list[list[int]]:
    """Height and width of the frames learnt from, those of most frames first."""
    frames = trained.request.dataset.frames
    counts = Counter(zip(frames.height.tolist(), frames.width.tolist(), strict=True))
    return [list(size) for size in sorted(counts, key=lambda size: (-counts[size], size))]


def _trained_frames(trained: Trained) -> dict[str, str]:
    """The frame numbers learnt from, by mission; empty where it was not the dataset's."""
    dataset = trained.request.dataset
    if trained.request.settings.two_images or dataset.block_frames is None:
        return {}
    frames = dataset.frames.groupby("mission").frame
    return {str(name): format_frames(numbers.tolist()) for name, numbers in frames}


def recipe_of(trained: Trained, **origin: str) -> dict[str, Any]:
    """Return what a model is made of, as plain JSON; `origin` is added to its provenance."""
    request, model = trained.request, trained.model
    dataset = request.dataset
    pairs = zip(model.classes, model.obstacle, strict=True)
    return {
        "recipe_version": RECIPE_VERSION,
        "hashed": True,
        "extractor": request.extractor.spec,
        "extractor_name": request.extractor_name,
        "dim": request.extractor.dim,
        "grid": dataset.grid.to_json(),
        "classes": [{"name": name, "obstacle": flag} for name, flag in pairs],
        "thresholds": model.thresholds.tolist(),
        "landmarks": model.landmarks,
        "operating_point": trained.operating_point.to_json(),
        "distribution": trained.distribution.summary() if trained.distribution else None,
        "sight": sight_to_json(_sight(trained)),
        "frame_sizes": _frame_sizes(trained),
        "fold_rules": [rule.to_json() for rule in trained.held_out.rules],
        "metrics": trained.metrics,
        "provenance": {
            "dataset": dataset.label,
            "dataset_hash": dataset.hash,
            "dataset_sources": "; ".join(dataset.info["sources"]),
            "missions": dataset.frames.mission.value_counts().to_dict(),
            "label_counts": dataset.info["labels"],
            "trained_frames": _trained_frames(trained),
            **({"masks": dataset.info["masks"]} if dataset.masks else {}),
            "preset": request.settings.preset,
            "penalty": trained.choice.penalty,
            "class_weight": trained.choice.class_weight or "none",
            "learnt_changes": ", ".join(request.settings.changes) or "none",
            **({"search": request.search} if request.search else {}),
            "code_version": code_version(),
            "libraries": ", ".join([f"{x} {version(x)}" for x in _LIBRARIES] + [_MLFLOW]),
            "kernels": KERNELS.name,
            **origin,
        },
    }


def content_of(
    trained: Trained,
    written: dict[str, Any],
    golden_frames: Sequence[U8] | None = None,
    **origin: str,
) -> BundleContent:
    """Return what the bundle holds, but for version and card, which wait for a number.

    Parameters
    ----------
    written : dict
        The model's recipe, as it was written.
    golden_frames : sequence of array of uint8, optional
        By default two pictures of the dataset.
    origin
        What is added to the provenance.
    """
    request = trained.request
    if golden_frames is None:
        golden_frames = _golden_frames(request.dataset)
    return BundleContent(
        name=request.name,
        version="",
        extractor_spec=written["extractor"],
        grid=request.dataset.grid,
        model=trained.model,
        provenance={**written["provenance"], **origin},
        metrics=written["metrics"],
        golden=golden_of(trained, golden_frames),
        trained_on=trained.trained_on,
        card="",
        operating_point=trained.operating_point,
        distribution=trained.distribution,
        sight=sight_from_json(written["sight"]),
        frame_sizes=tuple((height, width) for height, width in written["frame_sizes"]),
    )
