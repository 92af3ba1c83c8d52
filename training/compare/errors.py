"""Errors of each model: along the dive, and the worst patches."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tokt.features.common.arrays import Bools
from tokt.features.frames.mission import format_frames

from .predictions import ComparedModels, ModelPredictions

MISS, FALSE_ALARM, WRONG_CLASS = "miss", "false alarm", "wrong class"
KINDS = (MISS, FALSE_ALARM, WRONG_CLASS)
_MAX_STRETCHES = 40
_APART = 5  # frames
_PICTURES = 24  # of all kinds but wrong classes, and of all models together


def _wrong(compared: ComparedModels, predictions: ModelPredictions, kind: str) -> Bools:
    """Obstacles not seen, obstacles where none is, or another class on the right side."""
    said = predictions.score > 0
    if kind == MISS:
        return compared.truth & ~said
    if kind == FALSE_ALARM:
        return ~compared.truth & said
    same_side = compared.truth == said
    return np.asarray(same_side & (predictions.predicted != predictions.targets))


def errors_by_stretch(compared: ComparedModels) -> list[dict[str, Any]]:
    """Errors of each model in each block, in order; neighbours joined if there are many.

    A row is mission, frames, patches, obstacle, and models {label: {kind: patches}}. There is none
    where patches do not come from frames.
    """
    if not compared.has_frames:
        return []
    names, block = compared.blocks
    wrong = {
        item.label: {kind: _wrong(compared, item, kind) for kind in KINDS}
        for item in compared.models
    }
    rows = []
    for part in np.array_split(np.arange(len(names)), min(len(names), _MAX_STRETCHES)):
        mine = np.isin(block, part)
        patches = compared.patches[mine]
        rows.append(
            {
                "mission": ", ".join(sorted(set(patches.mission))),
                "frames": format_frames(patches.frame.unique().tolist()),
                "patches": int(mine.sum()),
                "obstacle": int(compared.truth[mine].sum()),
                "models": {
                    label: {kind: int(found[mine].sum()) for kind, found in kinds.items()}
                    for label, kinds in wrong.items()
                },
            }
        )
    return rows


def words_on_stretches(label: str, rows: Sequence[dict[str, Any]]) -> str:
    """Which stretch holds most of a model's errors."""
    wrong = [sum(row["models"][label].values()) for row in rows]
    if not sum(wrong):
        return f"{label} makes no error on these patches."
    worst = int(np.argmax(wrong))
    row = rows[worst]
    found = row["models"][label]
    kinds = f"{found[MISS]} missed, {found[FALSE_ALARM]} false alarms"
    kinds += f", {found[WRONG_CLASS]} of another class" if found[WRONG_CLASS] else ""
    return (
        f"{wrong[worst] / sum(wrong):.0%} of the {sum(wrong)} patches that {label} gets wrong lie "
        f"in frames {row['frames']} of {row['mission']} ({kinds}; {row['patches']} of "
        f"{sum(part['patches'] for part in rows)} patches)."
    )


def _worst(
    compared: ComparedModels, predictions: ModelPredictions, kind: str, count: int
) -> list[int]:
    """Rows of the most certain errors, none close to another: neighbours show the same thing."""
    wrong = np.flatnonzero(_wrong(compared, predictions, kind))
    order = wrong[np.argsort(-predictions.error_margin[wrong], kind="stable")]
    if not compared.has_frames:
        return [int(row) for row in order[:count]]
    keys = compared.patches[["mission", "camera", "frame"]].iloc[order]
    found: list[int] = []
    taken: list[tuple[str, str, int]] = []
    for row, key in zip(order.tolist(), keys.itertuples(index=False, name=None), strict=True):
        if len(found) == count:
            break
        if not any(key[:2] == (m, c) and abs(key[2] - f) < _APART for m, c, f in taken):
            taken.append(key)
            found.append(row)
    return found


def worst_errors(compared: ComparedModels) -> list[dict[str, Any]]:
    """The worst errors of each kind and model, far enough apart to differ.

    One is kind, of (the models it was chosen for), mission, camera, frame, row, col, label, and by
    model scores (decision value on the obstacle side, None where there are no sides) and said
    (class).
    """
    count = max(2, _PICTURES // (2 * len(compared.models)))
    chosen: dict[tuple[str, int], list[str]] = {}
    for kind in KINDS:
        for item in compared.models:
            for row in _worst(compared, item, kind, count):
                chosen.setdefault((kind, row), []).append(item.label)
    patches = compared.patches.iloc[[row for _, row in chosen]].drop(columns="group")
    return [
        {
            "kind": kind,
            "of": of,
            **patch,
            "scores": {
                item.label: float(item.score[row]) if np.isfinite(item.score[row]) else None
                for item in compared.models
            },
            "said": {
                item.label: item.classes[int(item.predicted[row])] for item in compared.models
            },
        }
        for ((kind, row), of), patch in zip(chosen.items(), patches.to_dict("records"), strict=True)
    ]
