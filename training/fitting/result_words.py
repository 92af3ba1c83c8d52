"""The result of a training in five lines: what was made, how good, at sea, not known, what next."""

from collections.abc import Mapping
from typing import Any

from tokt.features.common.errors import counted
from tokt.training.datasets.dataset import FRAME_KEY, DatasetVersion
from tokt.training.datasets.split import BLOCKS

from .train import Trained

FEW_FRAMES = 20
"""Labelled frames below which figures are called rough; a word of caution, nothing hangs on it."""


def result_in_words(label: str, trained: Trained, gained: str = "", as_good: str = "") -> list[str]:
    """Return what a training came to, in five lines for people who do not know the figures.

    `gained` says how good a model is that was adapted to a new dive, `as_good` the model that it
    was adapted from where that is as good there.
    """
    dataset, metrics = trained.request.dataset, trained.metrics
    missions = sorted(dataset.patches.mission.unique())
    what = counted(len(dataset.frames), "frame") if dataset.block_frames else "patches"
    where = missions[0] if len(missions) == 1 else f"{len(missions)} dives"
    return [
        f"Made: {label}, from {len(dataset.patches):,} labelled patches in {what} of {where}.",
        f"How good: {gained or _how_good(metrics, trained)}",
        f"At sea: {at_sea_in_words(metrics.get('frames'))}",
        f"Not known: {_not_known(trained, dataset)}",
        f"Next: {_next(label, as_good)}",
    ]


def _how_good(metrics: Mapping[str, Any], trained: Trained) -> str:
    """Recall and precision in words."""
    patch = metrics["patch"]
    if patch["f1"] is None:
        return f"macro-F1 {patch['macro_f1'] or 0:.3f} over its classes, on patches held out."
    unit = trained.request.split.unit(trained.request.dataset.patches)
    unseen = "frames" if unit == BLOCKS else unit
    found, right = (round(100 * (patch[key] or 0)) for key in ("recall", "precision"))
    return (
        f"in {unseen} that it did not learn from it finds {found} of 100 obstacle patches. Of 100 "
        f"patches that it calls obstacles {right} are (F1 {patch['f1']:.3f})."
    )


def at_sea_in_words(frames: Mapping[str, Any] | None) -> str:
    """Return what held-out frames say of warnings at sea."""
    if not frames or not (frames["ocean_frames"] or frames["obstacle_frames"]):
        return "not known: no whole frame is labelled."
    seen = (
        f"it warned in {frames['detected']} of {frames['obstacle_frames']} frames with an obstacle"
    )
    if not frames["obstacle_frames"]:
        seen = "no frame with an obstacle is labelled"
    if not frames["ocean_frames"]:
        return f"{seen}; how often it warns in open water is not known, as no frame shows it alone."
    false = f"in {frames['false_status']} of {frames['ocean_frames']} frames of open water"
    return f"{seen}, and wrongly {false}."


def _not_known(trained: Trained, dataset: DatasetVersion) -> str:
    """What the figures do not show."""
    missions = dataset.patches.mission.nunique()
    words = "another water, camera or light"
    if missions == 1:
        words = "how it does on another dive: figures of one dive flatter"
    frames = len(dataset.patches[FRAME_KEY].drop_duplicates())
    scores = [fold["f1"] for fold in trained.metrics["folds"] if fold["f1"] is not None]
    if dataset.block_frames and frames < FEW_FRAMES and len(scores) > 1:
        words += f". With so few frames F1 varies: {min(scores):.2f} to {max(scores):.2f} by fold"
    blind = [f"{one.width}x{one.height}" for one in dataset.sight if one.blind]
    if blind:
        words += f". In frames of {', '.join(blind)} a blurred view may look like open water to it"
    return f"{words}."


def _next(label: str, as_good: str) -> str:
    """What to type."""
    return (f"stay with {as_good}, label more, or " if as_good else "") + (
        f"test it on another dive: tokt evaluate {label} --mission DIR --labels FILE. Use it: tokt "
        f'deploy {label} STORE --reason "WHY", then tokt run --store STORE --source DIR.'
    )
