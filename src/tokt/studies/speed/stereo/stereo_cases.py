"""The cases of stereo pairs: whether a mission has what they need, and their measuring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import RIGHT, Mission
from tokt.inference.stereo.calibration import StereoCalibration, load_calibration
from tokt.studies.baselines.thesis_stereo import THESIS_FRAME_SIZE
from tokt.studies.speed.cases import Case
from tokt.studies.speed.paired_timing import BASELINE, OURS, Result, Times, in_turns, result
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .pairs import Pair, pair_numbers, read_pairs
from .pushbroom_case import PushbroomPair
from .stereo_case import StereoPair

CALIBRATION_FILE = "calibration.yml"
COMPARED_PAIRS = 40
"""At most so many pairs are judged both ways: the thesis's way takes a tenth of a second."""

Progress = Callable[..., Any]
Say = Callable[[str], None]


@dataclass(frozen=True)
class StereoInput:
    """The calibration that stereo is measured with.

    Parameters
    ----------
    calibration : StereoCalibration or None
        None where the cases are left out.
    words : str
        Where it is from, or why they are left out.
    """

    calibration: StereoCalibration | None
    words: str


def stereo_input(mission: Mission, calibration: StereoCalibration | None) -> StereoInput:
    """The calibration given, or the one in the mission's folder or beside it, if the pairs fit.

    Parameters
    ----------
    mission : Mission
    calibration : StereoCalibration or None
        As given by the user.
    """
    words = "calibration given"
    if calibration is None:
        inside, beside = (at / CALIBRATION_FILE for at in (mission.path, mission.path.parent))
        file = inside if inside.is_file() else beside
        words = f"{CALIBRATION_FILE} {'of' if file is inside else 'beside'} the mission"
        if not file.is_file():
            return _left_out(
                f"there is no {CALIBRATION_FILE} in it or beside it (--calibration FILE)"
            )
        try:
            calibration = load_calibration(file)
        except ToktError as error:
            return _left_out(str(error))
    if RIGHT not in mission.cameras:
        return _left_out("it has no right camera")
    first = next(read_pairs(mission, pair_numbers(mission)), None)
    if first is None:
        return _left_out("no pair of it can be read")
    if first.sizes != {THESIS_FRAME_SIZE} or calibration.frame_size != THESIS_FRAME_SIZE:
        size = "x".join(map(str, THESIS_FRAME_SIZE))
        return _left_out(f"the thesis's pipeline is for frames of {size}")
    return StereoInput(calibration, words)


def _left_out(why: str) -> StereoInput:
    return StereoInput(None, f"left out: {why}")


def measure_stereo(
    mission: Mission,
    calibration: StereoCalibration,
    compared: int | None,
    timed: int,
    rounds: int,
    progress: Progress,
    say: Say,
) -> list[Result]:
    """Both cases: compared on pairs of the whole mission, then timed on a few of them.

    Parameters
    ----------
    mission : Mission
    calibration : StereoCalibration
    compared : int or None
        Pairs that are judged both ways, at most `COMPARED_PAIRS`; None for as many.
    timed, rounds : int
        Pairs kept in memory, and how often each is timed.
    progress, say : callable

    Raises
    ------
    ToktError
        If no pair can be judged.
    """
    stereo, pushbroom = StereoPair(calibration), PushbroomPair(calibration)
    numbers = evenly_spaced(pair_numbers(mission), min(compared or COMPARED_PAIRS, COMPARED_PAIRS))
    judged = []
    for pair in progress(read_pairs(mission, numbers), len(numbers), "compare pairs"):
        pushbroom.check(pair)
        # A refused pair costs the runtime next to nothing: timing it would flatter.
        if stereo.check(pair):
            judged.append(pair.number)
    if not judged:
        raise ToktError(f"mission {mission.name}: the runtime refuses to judge any of its pairs")
    pairs = list(read_pairs(mission, evenly_spaced(judged, timed)))
    obstacle = np.array([bool(stereo.sees_obstacle(pair)) for pair in pairs])
    results = []
    cases: tuple[Case[Pair], ...] = (stereo, pushbroom)
    for case in cases:
        say(f"-- {case.name}")
        times = in_turns(case.timed(), pairs, rounds)
        kinds = by_kind(times, obstacle)
        results.append(result(case.name, times, case.exact, {**case.findings(), **kinds}))
    return results


def by_kind(times: Times, obstacle: NDArray[np.bool_]) -> dict[str, Any]:
    """Medians over the pairs with an obstacle alone, and over those without: matching costs more
    where there is more to match.

    Parameters
    ----------
    times : mapping
        Seconds of `BASELINE` and `OURS` as `in_turns` gives them.
    obstacle : array of bool, shape (n_items,)
        By ours.

    Returns
    -------
    dict
        ``with_obstacle`` and ``without_obstacle``: pairs, baseline_ms, ours_ms and ratio, or None
        where there is no such pair.
    """
    return {
        name: _medians(times, chosen)
        for name, chosen in (("with_obstacle", obstacle), ("without_obstacle", ~obstacle))
    }


def _medians(times: Times, chosen: NDArray[np.bool_]) -> dict[str, float] | None:
    if not chosen.any():
        return None
    baseline, ours = (
        float(np.median(times[name].reshape(-1, len(chosen))[:, chosen])) * 1000
        for name in (BASELINE, OURS)
    )
    return {
        "pairs": int(chosen.sum()),
        "baseline_ms": baseline,
        "ours_ms": ours,
        "ratio": baseline / ours,
    }
