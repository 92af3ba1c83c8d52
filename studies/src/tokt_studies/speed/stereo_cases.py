"""Stereo pairs and the cases timed on them: the thesis's disparity pipeline against tokt's two."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tokt.features.common.arrays import I64, U8, Bools
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.features.kernels.dispatch import LIBRARY, load_kernels
from tokt.inference.frame import Frame, pair_shape_fault
from tokt.inference.reason import Reason
from tokt.inference.stereo.calibration import StereoCalibration, load_calibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.pushbroom import BAND, CELL_PX, PushbroomDetector
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.baselines.thesis_stereo import THESIS_FRAME_SIZE, THESIS_SIZE_WORDS, judge_pair
from tokt_studies.baselines.thesis_texture import GRID

from .cases import Case
from .paired_timing import BASELINE, OURS, BenchRequest, Result, Times, in_turns, result

CALIBRATION_FILE = "calibration.yml"
COMPARED_PAIRS = 40
"""At most so many pairs are judged both ways: the thesis's way takes a tenth of a second."""
MAX_DIFFERENT = 0.01
"""Part of the cells that both found whose depths may be further apart than a slice is deep."""


@dataclass(frozen=True)
class Pair:
    """Two decoded frames of one moment."""

    number: int
    left: U8  # (height, width) or (height, width, 3)
    right: U8

    @cached_property
    def frame(self) -> Frame:
        """The pair as a source delivers it."""
        return Frame(self.number, float(self.number), self.left, self.right)


def pair_numbers(mission: Mission) -> list[int]:
    """Frames that both cameras have, in order."""
    return sorted(set(mission.frames(LEFT)) & set(mission.frames(RIGHT)))


def read_pairs(mission: Mission, numbers: Iterable[int]) -> Iterator[Pair]:
    """Decode pairs, leaving out those of which an image cannot be read."""
    for number in numbers:
        try:
            yield Pair(number, mission.read(number, LEFT), mission.read(number, RIGHT))
        except FrameError:
            continue


class PairCase(Case[Pair]):
    """A decoded pair to its detection, by the thesis's disparity pipeline and by a detector.

    `exact_is` says what `check` holds ours against; of the thesis's pipeline nothing could be.
    """

    what = "pairs"

    def __init__(self, name: str, exact_is: str) -> None:
        super().__init__(name)
        self.refused = 0  # pairs that ours did not judge
        self._obstacles = {"baseline": 0, "ours": 0}
        self.about = {
            "of": "one decoded pair to its verdict",
            "baseline_is": "the thesis's disparity pipeline: full resolution, not rectified",
            "exact_is": exact_is,
            "obstacle_pairs": self._obstacles,
        }

    def baseline(self, item: Pair) -> object:
        """Undistort, match, stretch, contours."""
        return judge_pair(item.left, item.right)

    def compared(self, item: Pair, different: bool, obstacle: bool) -> bool:
        """Count a pair, and whether either way sees an obstacle: True, as `check` says it."""
        self.checked += 1
        self.wrong += different
        self._obstacles["ours"] += obstacle
        self._obstacles["baseline"] += judge_pair(item.left, item.right).obstacle
        return True

    def findings(self) -> dict[str, Any]:
        """What was compared."""
        return {**super().findings(), "pairs_refused": self.refused}


class StereoPair(PairCase):
    """A decoded pair to its detection, as ``tokt run --policy disparity`` does it."""

    def __init__(self, calibration: StereoCalibration) -> None:
        super().__init__(
            "stereo.pair", "ours matches every pixel as it does with OpenCV's own StereoBM"
        )
        self._detector = DisparityDetector(calibration, GRID)
        self._library = DisparityDetector(calibration, GRID, kernels=load_kernels(LIBRARY))

    def ours(self, item: Pair) -> object:
        """Rectify, match, filter, distance."""
        return self._detector.detect(item.frame)

    def sees_obstacle(self, item: Pair) -> bool | None:
        """Whether ours says obstacle; None where it refuses to judge."""
        found = self._detector.detect(item.frame)
        if found.mask is None:  # of pairs far apart the rule over frames knows nothing
            return False if found.fault.reason is Reason.FRAME_RULE else None
        return bool(np.mean(found.mask) > STATUS_MEAN_THRESHOLD)

    def check(self, item: Pair) -> bool:
        """The matches of every pixel with tokt's kernels and with OpenCV's own block matching."""
        seen = self.sees_obstacle(item)
        if seen is None:
            self.refused += 1
            return False
        ours, theirs = (
            detector.match(item.left, item.right) for detector in (self._detector, self._library)
        )
        valid = ours.valid
        same = np.array_equal(valid, theirs.valid) and np.array_equal(
            ours.disparity_px[valid], theirs.disparity_px[valid]
        )
        return self.compared(item, not same, seen)


class PushbroomPair(PairCase):
    """A decoded pair to its detection, as ``tokt run --stereo pushbroom`` does it."""

    def __init__(self, calibration: StereoCalibration) -> None:
        super().__init__(
            "pushbroom.pair",
            f"depths are within {BAND:.0%} of dense matching's in {1 - MAX_DIFFERENT:.0%} of a "
            "pair's cells that both found",
        )
        self._detector = PushbroomDetector(calibration, GRID)
        self._dense = DisparityDetector(calibration, GRID)
        self._places = self._dense_places()
        self._cells = {"found": 0, "found_by_both": 0}

    def _dense_places(self) -> I64:
        """The pixel (x, y) of the dense view at the middle of each cell, shape (n_cells, 2)."""
        width, height = self._detector.rectifier.size
        rows, columns = np.indices((height // CELL_PX, width // CELL_PX)).reshape(2, -1)
        middles = np.column_stack([columns, rows]) * CELL_PX + (CELL_PX - 1) / 2
        dense = self._dense.rectifier
        places = dense.from_frame(self._detector.rectifier.to_frame(middles))
        return places.round().astype(np.int64).clip(0, np.array(dense.size) - 1)

    def ours(self, item: Pair) -> object:
        """Rectify, match at a few disparities, remember."""
        return self._detector.detect(item.frame)

    def check(self, item: Pair) -> bool:
        """Every depth that ours finds against the one that dense matching finds there."""
        if pair_shape_fault(item.frame, self._detector.calibration.frame_size):
            self.refused += 1
            return False
        ours = self._detector.look(item.left, item.right).ravel()
        matches = self._dense.match(item.left, item.right)
        x, y = self._places[ours > 0].T
        both = matches.valid[y, x]
        dense = self._dense.rectifier.focal_baseline_px_m / matches.disparity_px[y, x][both]
        apart = np.abs(ours[ours > 0][both] / dense - 1) > BAND
        self._cells["found"] += int((ours > 0).sum())
        self._cells["found_by_both"] += int(both.sum())
        different = bool(apart.sum() > MAX_DIFFERENT * apart.size)
        return self.compared(item, different, bool(ours.any()))

    def findings(self) -> dict[str, Any]:
        """What was compared, and how many cells."""
        return {**super().findings(), "cells": dict(self._cells)}


class StereoInput(NamedTuple):
    """The calibration that stereo is measured with."""

    calibration: StereoCalibration | None  # None where the cases are left out
    words: str  # where it is from, or why they are left out


def stereo_input(mission: Mission, calibration: StereoCalibration | None) -> StereoInput:
    """The calibration given, or the one in the mission's folder or beside it, if the pairs fit."""
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
    sizes = {image.shape[1::-1] for image in (first.left, first.right)}
    if sizes != {THESIS_FRAME_SIZE} or calibration.frame_size != THESIS_FRAME_SIZE:
        return _left_out(f"the thesis's pipeline is for frames of {THESIS_SIZE_WORDS}")
    return StereoInput(calibration, words)


def _left_out(why: str) -> StereoInput:
    return StereoInput(None, f"left out: {why}")


def measure_stereo(
    mission: Mission, calibration: StereoCalibration, asked: BenchRequest
) -> list[Result]:
    """Both cases: compared on pairs of the whole mission, then timed on a few of them.

    At most `COMPARED_PAIRS` are judged both ways. That none can be judged is a `ToktError`.
    """
    size = asked.size
    stereo, pushbroom = StereoPair(calibration), PushbroomPair(calibration)
    most = min(size.compared or COMPARED_PAIRS, COMPARED_PAIRS)
    numbers = evenly_spaced(pair_numbers(mission), most)
    judged = []
    for pair in asked.progress(read_pairs(mission, numbers), len(numbers), "compare pairs"):
        pushbroom.check(pair)
        # A refused pair costs the runtime next to nothing: timing it would flatter.
        if stereo.check(pair):
            judged.append(pair.number)
    if not judged:
        raise ToktError(f"mission {mission.name}: the runtime refuses to judge any of its pairs")
    pairs = list(read_pairs(mission, evenly_spaced(judged, size.timed)))
    obstacle = np.array([bool(stereo.sees_obstacle(pair)) for pair in pairs])
    results = []
    cases: tuple[Case[Pair], ...] = (stereo, pushbroom)
    for case in cases:
        asked.say(f"-- {case.name}")
        times = in_turns(case.timed(), pairs, size.rounds)
        kinds = by_kind(times, obstacle)
        results.append(result(case.name, times, case.exact, {**case.findings(), **kinds}))
    return results


def by_kind(times: Times, obstacle: Bools) -> dict[str, Any]:
    """Medians over the pairs with an obstacle by ours, and over those without; None without a pair.

    Matching costs more where there is more to match.
    """
    found: dict[str, Any] = {"with_obstacle": None, "without_obstacle": None}
    for name, chosen in zip(found, (obstacle, ~obstacle), strict=True):
        if chosen.any():
            part = {way: times[way].reshape(-1, len(chosen))[:, chosen] for way in (BASELINE, OURS)}
            medians = result("", part, True, {})
            figures = {key: getattr(medians, key) for key in ("baseline_ms", "ours_ms", "ratio")}
            found[name] = {"pairs": int(chosen.sum()), **figures}
    return found
