"""What the page's threshold explorer works on: counts at many thresholds, ranks of all scores."""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...models.operating_point import FrameRule
from .frames import OBSTACLE_FRAME, OCEAN, sequences
from .judged import Contender, Judged

_STEPS = 250  # with the three that are added, a rank among them fits a byte
_TAIL = 0.005  # of the obstacles' scores on either side; the slider's ends


def _thresholds(
    score: NDArray[np.float64], truth: NDArray[np.bool_], rule: FrameRule
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
    now = [] if rule.margin_now is None else [rule.margin_now]
    return np.unique([*(float(f"{step:.4g}") for step in steps), 0.0, rule.margin, *now])


def _of_model(judged: Judged, contender: Contender) -> dict[str, Any]:
    thresholds = _thresholds(contender.score, judged.truth, contender.rule)
    sides = [np.sort(contender.score[side]) for side in (judged.truth, ~judged.truth)]
    hit, false = (
        (len(side) - np.searchsorted(side, thresholds, side="right")).tolist() for side in sides
    )
    # A score exceeds thresholds[k] exactly where its rank exceeds k: nothing is rounded.
    ranks = np.searchsorted(thresholds, contender.on_grid, side="left").astype(np.uint8)
    return {
        "thresholds": thresholds.tolist(),
        "true_positive": hit,
        "false_positive": false,
        "rule": contender.rule.to_json(),
        "white": contender.white,
        "patches": ranks.shape[1],
        "ranks": b64encode(ranks.tobytes()).decode("ascii"),
        "judged": contender.judged.tolist(),
    }


def explorer_data(judged: Judged) -> dict[str, Any]:
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
    table = judged.series.table
    named = [
        {
            "name": str(table.mission[rows.start])
            + ("" if table.camera[rows.start] == "left" else f" ({table.camera[rows.start]})"),
            "start": rows.start,
            "stop": rows.stop,
        }
        for rows in sequences(judged.series)
    ]
    return {
        "obstacle": int(judged.truth.sum()),
        "clear": int((~judged.truth).sum()),
        "frames": {
            "number": table.frame.tolist(),
            "ocean": judged.series.kind(OCEAN).tolist(),
            "obstacle": judged.series.kind(OBSTACLE_FRAME).tolist(),
            "gap": judged.series.gaps.tolist(),
        },
        "sequences": named,
        "models": {c.label: _of_model(judged, c) for c in judged.contenders},
    }
