"""The gate before a model takes over: each dive, false statuses and time against today's model."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64, Bools
from tokt.models.operating_point import OBSTACLE
from tokt.training.evaluation.frame_scores import KEYS
from tokt.training.fitting.choose_operating_point import BOUND_CONFIDENCE
from tokt.training.fitting.exceedance_model import upper_bound

from .bootstrap import CONFIDENCE, block_numbers, drawn_blocks, interval, summed
from .comparison import measure_times
from .frames import OBSTACLE_FRAME
from .pairs import WORSE, compare_pairs
from .predictions import ComparedModels, ModelPredictions

MAX_SLOWER = 1.6
"""How many times as long as today's model a new one may take for a frame, where nobody said."""
SEEN, FALSE_STATUS = "seen", "false status"


@dataclass(frozen=True)
class GateRow:
    """One figure of both models on one dive, or on all dives together (`dive` is empty).

    `low` and `high` bound the difference, candidate less champion, at `CONFIDENCE`; None where
    there are too few blocks to tell.
    """

    dive: str
    figure: str
    blocks: int
    champion: float | None
    candidate: float | None
    low: float | None = None
    high: float | None = None
    worse: bool = False
    remark: str = ""


def judge_candidate(compared: ComparedModels, max_ms: float | None = None) -> dict[str, Any]:
    """Hold a candidate against the champion on what neither learnt from.

    The candidate fails where an interval of its difference lies wholly below 0 on a dive (blocks
    of frames are drawn within the dive): F1, AP, share of the obstacle frames that have status 1.
    So it does where it is worse over all dives together; where its false statuses are more, beyond
    doubt, than its operating point was chosen for; where it never warns; where it takes longer.

    Parameters
    ----------
    compared : ComparedModels
        Of two models: the candidate, then the champion.
    max_ms : float, optional
        Median time a frame that the candidate may take here; by default `MAX_SLOWER` times the
        champion's.

    Returns
    -------
    dict
        JSON: what, mode, table (`GateRow`), false_status, time, faults (a line each, none where
        the candidate passes) and notes.
    """
    candidate, champion = compared.models
    dives = list(dict.fromkeys(compared.series.table.mission))
    rows = [row for dive in dives for row in _of_dive(compared.of_dive(dive), dive)]
    if len(dives) > 1:
        rows += _patch_rows(compared, "")
    false = _false_statuses(compared, candidate)
    times = measure_times(compared)["models"]
    was, now = (float(times[item.label]["median_ms"]) for item in (champion, candidate))
    limit = MAX_SLOWER * was if max_ms is None else max_ms
    faults = [_words(row, compared.unit) for row in rows if row.worse]
    if candidate.bundle.silence:
        faults.append(candidate.bundle.silence)
    if false["beyond_target"]:
        faults.append(
            f"false statuses in {false['false_blocks']} of {false['blocks']} blocks of ocean "
            f"frames, at least {false['low']:.2g} of blocks ({BOUND_CONFIDENCE:.0%} confidence): "
            f"the rate it was chosen for, {false['target_rate']:g} of frames, makes it "
            f"{false['target_of_blocks']:.2g} at most"
        )
    if now > limit:
        faults.append(f"{now:.2f} ms a frame, more than {limit:.2f}")
    return {
        "what": compared.what,
        "mode": compared.mode,
        "table": [asdict(row) for row in rows],
        "false_status": false,
        "time": {"champion_ms": was, "candidate_ms": now, "max_ms": limit},
        "faults": faults,
        "notes": compared.notes,
    }


def _words(row: GateRow, unit: str) -> str:
    where = f"dive {row.dive}" if row.dive else "all dives together"
    return (
        f"worse on {where}: {row.figure} {row.champion:.3f} -> {row.candidate:.3f} "
        f"({CONFIDENCE:.0%} interval of the difference {row.low:+.3f} to {row.high:+.3f}, "
        f"{row.blocks} {'blocks' if row.dive else unit})"
    )


def _of_dive(part: ComparedModels, dive: str) -> list[GateRow]:
    rows = _patch_rows(part, dive)
    if not part.has_frames:
        return rows
    obstacle, ocean = part.series.kind(OBSTACLE_FRAME), _ocean(part)
    said = [part.status(item) == OBSTACLE for item in part.models]
    if obstacle.any():
        counts = [_by_block(part, obstacle, one) for one in said]
        draws = drawn_blocks(len(counts[0]))
        spread = [_share(summed(draws, one)) for one in counts]
        values = [float(one[obstacle].mean()) for one in said]
        bounds = interval(spread[0] - spread[1], len(counts[0]))
        rows.append(_row(dive, SEEN, len(counts[0]), values, bounds))
    if ocean.any():
        new, old = (int((one & ocean).sum()) for one in said)
        remark = f"of {ocean.sum()} ocean frames"
        remark += "; none by the champion" if new and not old else ""
        blocks = len(_by_block(part, ocean, ocean))
        rows.append(GateRow(dive, FALSE_STATUS, blocks, old, new, remark=remark))
    return rows


def _patch_rows(part: ComparedModels, dive: str) -> list[GateRow]:
    """F1 and AP: of a dive by the interval alone; over dives, which may be few, by the verdict."""
    found = compare_pairs(part)
    if not found["pairs"]:
        remark = "no F1: no patch is labelled as an obstacle, or a model knows one side alone"
        return [GateRow(dive, "F1", found["blocks"], None, None, remark=remark)]
    pair, title = found["pairs"][0], found["measure_title"]
    worse = None if dive else pair["verdict"] == WORSE
    rows = [_row(dive, title, found["blocks"], pair["values"], _pair(pair["interval"]), worse)]
    if dive and pair["average_precision"] is not None:
        values = [part.figures(item)["patch"]["average_precision"] for item in part.models]
        bounds = _pair(pair["average_precision"]["interval"])
        rows.append(_row(dive, "AP", found["blocks"], values, bounds))
    return rows


def _pair(bounds: dict[str, float] | None) -> tuple[float, float] | None:
    return None if bounds is None else (bounds["low"], bounds["high"])


def _row(
    dive: str,
    figure: str,
    blocks: int,
    values: list[float],
    bounds: tuple[float, float] | None,
    worse: bool | None = None,
) -> GateRow:
    low, high = bounds or (None, None)
    if worse is None:
        worse = high is not None and high < 0
    few = "cannot be told of so few" if bounds is None else "few: the interval is rough"
    remark = few if bounds is None or 2 / 2**blocks > 1 - CONFIDENCE else ""
    return GateRow(dive, figure, blocks, values[1], values[0], low, high, worse, remark)


def _ocean(part: ComparedModels) -> Bools:
    """Ocean frames whose status no rule holds on to from an obstacle before them."""
    rules = [rule for item in part.models for rule in (item.rule, *(item.fold_rules or ()))]
    return part.series.ocean_apart(max(rule.n for rule in rules))


def _by_block(part: ComparedModels, frames: Bools, said: Bools) -> F64:
    """Of some labelled frames in each block: with status 1, and all; shape (blocks, 2)."""
    group = part.patches.drop_duplicates(KEYS).set_index(KEYS).group
    keys = pd.MultiIndex.from_frame(part.series.table.loc[frames, KEYS])
    names, block = block_numbers(group.loc[keys].to_numpy(object))
    counts = [np.bincount(block, weight, len(names)) for weight in (said[frames], None)]
    return np.stack(counts, axis=1).astype(np.float64)


def _share(counts: F64) -> F64:
    return counts[:, 0] / counts[:, 1]


def _false_statuses(compared: ComparedModels, candidate: ModelPredictions) -> dict[str, Any]:
    """The candidate's false statuses by blocks, against the rate its rule was chosen for.

    A block of k frames has one with a chance of k times the rate at the most. The bound is that
    of Clopper and Pearson (1934), one-sided.
    """
    target = candidate.bundle.operating_point.chosen.get("target_rate")
    ocean = _ocean(compared) if compared.has_frames else np.zeros(0, bool)
    found = {"target_rate": target, "ocean_frames": int(ocean.sum()), "beyond_target": False}
    if target is None or not ocean.any():
        return found
    counts = _by_block(compared, ocean, compared.status(candidate) == OBSTACLE)
    blocks, false = len(counts), int((counts[:, 0] > 0).sum())
    low = 1 - upper_bound(blocks - false, blocks, BOUND_CONFIDENCE)
    of_blocks = min(1.0, float(target) * int(ocean.sum()) / blocks)
    return {
        **found,
        "frames": int(counts[:, 0].sum()),
        "blocks": blocks,
        "false_blocks": false,
        "low": low,
        "target_of_blocks": of_blocks,
        "beyond_target": low > of_blocks,
    }
