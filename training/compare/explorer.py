"""Data of the page's threshold explorer: counts at many thresholds, ranks of all scores."""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.models.operating_point import MofNRule

from .frames import OBSTACLE_FRAME, OCEAN
from .predictions import ComparedModels, ModelPredictions

_STEPS = 250  # with the three that are added, a rank among them fits a byte
_TAIL = 0.005  # of the obstacles' scores on either side; the slider's ends


def _thresholds(
    score: NDArray[np.float64], truth: NDArray[np.bool_], rule: MofNRule
) -> NDArray[np.float64]:
    """The slider's steps, with 0 and the rule's margins among them.

    Close together around 0 and wide apart further out (evenly in asinh): some features give
    decision values in the hundreds, and what is decided is decided near 0.
    """
    looked_at = score[truth] if truth.any() else score
    low, high = np.quantile(looked_at, [_TAIL, 1 - _TAIL])
    scale = max(float(np.median(np.abs(looked_at))), 1e-6)
    first, last = np.arcsinh(
        [min(low, -0.2 * scale) / scale, max(high, 1.5 * rule.margin, scale) / scale]
    )
    steps = scale * np.sinh(np.linspace(float(first), float(last), _STEPS))
    now = [] if rule.instant_margin is None else [rule.instant_margin]
    return np.unique([*(float(f"{step:.4g}") for step in steps), 0.0, rule.margin, *now])


def _of_model(compared: ComparedModels, predictions: ModelPredictions) -> dict[str, Any]:
    thresholds = _thresholds(predictions.score, compared.truth, predictions.rule)
    sides = [np.sort(predictions.score[side]) for side in (compared.truth, ~compared.truth)]
    hit, false = (
        (len(side) - np.searchsorted(side, thresholds, side="right")).tolist() for side in sides
    )
    # A score exceeds thresholds[k] exactly where its rank exceeds k: nothing is rounded.
    ranks = np.searchsorted(thresholds, predictions.on_grid, side="left").astype(np.uint8)
    return {
        "thresholds": thresholds.tolist(),
        "true_positive": hit,
        "false_positive": false,
        "rule": predictions.rule.to_json(),
        "white": predictions.white,
        "patches": ranks.shape[1],
        "ranks": b64encode(ranks.tobytes()).decode("ascii"),
        "judged": predictions.judged.tolist(),
    }


def explorer_data(compared: ComparedModels) -> dict[str, Any]:
    """Counts and ranks from which the page finds every figure for any of its thresholds.

    Returns
    -------
    dict
        obstacle, clear (patches), frames {number, ocean, obstacle, gap}, sequences {name, start,
        stop}, and models {label: {thresholds, true_positive, false_positive, rule, white, patches,
        ranks, judged}}: patches above each threshold, and for every patch of every frame (bytes
        in base64, `patches` a frame, row by row of the grid) how many thresholds its score
        exceeds, 0 where it has none. `white` is the fewest patches that a status takes.
    """
    table = compared.series.table
    named = [
        {
            "name": str(table.mission[rows.start])
            + ("" if table.camera[rows.start] == "left" else f" ({table.camera[rows.start]})"),
            "start": rows.start,
            "stop": rows.stop,
        }
        for rows in compared.series.sequences()
    ]
    return {
        "obstacle": int(compared.truth.sum()),
        "clear": int((~compared.truth).sum()),
        "frames": {
            "number": table.frame.tolist(),
            "ocean": compared.series.kind(OCEAN).tolist(),
            "obstacle": compared.series.kind(OBSTACLE_FRAME).tolist(),
            "gap": compared.series.gaps.tolist(),
        },
        "sequences": named,
        "models": {c.label: _of_model(compared, c) for c in compared.models},
    }
