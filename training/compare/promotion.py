"""The gate before a model takes over: each dive, false statuses and time against today's model."""

from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64, Bools
from tokt.models.operating_point import OBSTACLE
from tokt.training.datasets.dataset import FRAME_KEY
from tokt.training.evaluation.metrics import upper_bound
from tokt.training.evaluation.old_dives import falls

from .bootstrap import CONFIDENCE, block_numbers, drawn_blocks, interval, summed
from .comparison import measure_times
from .frames import OBSTACLE_FRAME
from .pairs import WORSE, compare_pairs
from .predictions import ComparedModels

MAX_SLOWER = 1.6
MIN_BLOCKS = 4
"""That an interval takes: of two equal models one is called worse on 25, 11, 5 and 5 of 100 dives
of 2, 3, 4 and 6 simulated blocks, on 4 of 100 of 10 and more."""
SEEN, FALSE_STATUS = "seen", "false status"


def judge_candidate(compared: ComparedModels, max_ms: float | None = None) -> dict[str, Any]:
    """Hold the first of two models, a candidate, against the second, today's champion.

    The candidate fails where the interval of a difference lies wholly below 0 on a dive (blocks of
    frames drawn within it): F1, AP, share of the obstacle frames with status 1. It fails too where
    a dive's F1, or the mean of the dives', falls by more than the rule allows (`falls`), where
    it is worse over all dives, by the verdict of `compare_pairs`; where false statuses are more,
    beyond doubt, than its operating point was chosen for; where it is never seen to warn; where no
    interval can be told at all; and where its median time a frame is above `max_ms`, by default
    `MAX_SLOWER` times the champion's.

    Returns JSON: what, mode, table (a row a figure of a dive, or of all where `dive` is empty),
    time, faults (a line each) and notes.
    """
    dives = list(dict.fromkeys(compared.series.table.mission))
    parts = {dive: compared.of_dive(dive) for dive in dives}
    rows = [row for dive, part in parts.items() for row in _of_dive(part, dive)]
    rows += _patch_rows(compared, "") if len(dives) > 1 else []
    rows += _false_statuses(compared, "")
    times = measure_times(compared)["models"]
    now, was = (float(times[item.label]["median_ms"]) for item in compared.models)
    limit = MAX_SLOWER * was if max_ms is None else max_ms
    faults = [
        f"worse on {'dive ' + row['dive'] if row['dive'] else 'all together'}: {row['figure']} "
        f"{row['champion']:.3f} -> {row['candidate']:.3f} ({row['remark']})"
        for row in rows
        if row["worse"]
    ]
    faults += [f"old dives lose too much: {line}" for line in _falls(parts)]
    faults += filter(None, [compared.models[0].bundle.silence])
    if not any(row["interval"] for row in rows):
        faults.append("too few blocks to tell anything: compare them on more dives (--mission)")
    if now > limit:
        faults.append(f"{now:.2f} ms a frame, more than {limit:.2f}")
    return {
        **{"what": compared.what, "mode": compared.mode, "table": rows, "faults": faults},
        "time": {"champion_ms": was, "candidate_ms": now, "max_ms": limit},
        "notes": compared.notes,
    }


def _falls(parts: dict[str, ComparedModels]) -> list[str]:
    """What the dives' F1 of obstacles loses beyond the rule."""
    candidate, champion = (
        {dive: part.figures(part.models[which])["patch"]["f1"] for dive, part in parts.items()}
        for which in (0, 1)
    )
    return falls(before=champion, after=candidate)


def _of_dive(part: ComparedModels, dive: str) -> list[dict[str, Any]]:
    rows = _patch_rows(part, dive)
    obstacle = part.series.kind(OBSTACLE_FRAME)
    if part.has_frames and obstacle.any():
        counts = _by_block(part, obstacle)
        spread = summed(drawn_blocks(counts.shape[1]), counts.transpose(1, 0, 2))
        share = spread[..., 0] / spread[..., 1]
        bounds = interval(share[:, 0] - share[:, 1], counts.shape[1])
        whole = counts.sum(axis=1)
        rows.append(_row(dive, SEEN, counts.shape[1], whole[:, 0] / whole[:, 1], bounds))
    return rows + _false_statuses(part, dive)


def _patch_rows(part: ComparedModels, dive: str) -> list[dict[str, Any]]:
    """F1 and AP of a dive by the interval alone; over dives, which may be few, by the verdict."""
    found = compare_pairs(part)
    blocks, title = found["blocks"], found["measure_title"]
    if not found["pairs"]:
        row = _row(dive, title, blocks, (None, None), None)
        return [{**row, "remark": "no obstacle patch, or a model of one side: nothing to compare"}]
    pair, ap = found["pairs"][0], found["pairs"][0]["average_precision"]
    row = _row(dive, title, blocks, pair["values"], pair["interval"])
    if not dive:
        return [{**row, "worse": pair["verdict"] == WORSE}]
    values = [part.figures(item)["patch"]["average_precision"] for item in part.models]
    return [row] if ap is None else [row, _row(dive, "AP", blocks, values, ap["interval"])]


def _row(
    dive: str, figure: str, blocks: int, values: Any, bounds: dict[str, float] | None
) -> dict[str, Any]:
    candidate, champion = (None if value is None else float(value) for value in values)
    units = f"{blocks} {'blocks' if dive else 'dives'}"
    if bounds is None or blocks < MIN_BLOCKS:
        bounds, worse, remark = None, False, f"{units} are too few to tell"
    else:
        worse, remark = bounds["high"] < 0, f"by {bounds['low']:+.3f} to {bounds['high']:+.3f}"
        remark += f", rough: {units}" if 2 / 2**blocks > 1 - CONFIDENCE else ""
    return {
        **{"dive": dive, "figure": figure, "blocks": blocks, "interval": bounds},
        **{"champion": champion, "candidate": candidate, "worse": worse, "remark": remark},
    }


def _by_block(part: ComparedModels, frames: Bools) -> F64:
    """Some labelled frames of each block: with status 1, and all; shape (models, blocks, 2)."""
    group = part.patches.drop_duplicates(FRAME_KEY).set_index(FRAME_KEY).group
    keys = pd.MultiIndex.from_frame(part.series.table.loc[frames, FRAME_KEY])
    names, block = block_numbers(group.loc[keys].to_numpy(object))
    counts = [
        [np.bincount(block, weight, len(names)) for weight in (said[frames] == OBSTACLE, None)]
        for said in map(part.status, part.models)
    ]
    return np.asarray(np.transpose(counts, (0, 2, 1)), np.float64)


def _false_statuses(part: ComparedModels, dive: str) -> list[dict[str, Any]]:
    """False statuses; of all dives together against the rate the candidate's rule was chosen for.

    A block of k ocean frames has one with a chance of k times the rate at most. By the one-sided
    bound of Clopper and Pearson (1934). What a rule may hold on to from an obstacle is left out.
    """
    rules = [rule for item in part.models for rule in (item.rule, *(item.fold_rules or ()))]
    ocean = part.series.ocean_apart(max(rule.n for rule in rules))
    if not part.has_frames or not ocean.any():
        return []
    counts = _by_block(part, ocean)
    frames, blocks = int(ocean.sum()), counts.shape[1]
    (new, old), hit = counts[..., 0].sum(axis=1), int((counts[0, :, 0] > 0).sum())
    row = _row(dive, FALSE_STATUS, blocks, (new / frames, old / frames), None)
    row["remark"] = f"{new:.0f} of {frames} ocean frames, in {hit} of {blocks} blocks"
    row["remark"] += ", none by the champion" if new and not old else ""
    rate = part.models[0].bundle.operating_point.chosen.get("target_rate")
    if not dive and rate is not None:
        low, most = 1 - upper_bound(blocks - hit, blocks), rate * frames / blocks
        row["worse"] = low > most
        row["remark"] += f": at least {low:.2g} of blocks; chosen for {most:.2g} at most"
    return [row]
