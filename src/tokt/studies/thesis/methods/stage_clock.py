"""The methods that the run-time tables compare, timed stage by stage, in turns on one thread.

What is counted is the thread's own processor time: on an idle machine the time that passes, and on
a busy one not what others take.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tokt.features.extractors.extractor import Extractor
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.frames.image_file import decode_image
from tokt.inference.frame import Frame
from tokt.inference.frame_checks import frame_fault
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import Verdict, verdict_from_mask
from tokt.models.linear import LinearModel
from tokt.studies.baselines.slic import SlicTexture, resized_bgr, superpixels
from tokt.studies.baselines.thesis_models import ThesisModel
from tokt.studies.baselines.thesis_stereo import (
    LEFT_CAMERA,
    RIGHT_CAMERA,
    disparity_map,
    judge_pair,
    undistorted,
)
from tokt.studies.baselines.thesis_texture import GRID, resized_gray

from .curves import OURS, THESIS
from .texture_histograms import EXTRACTORS

STAGES = (
    "decode",
    "resize",
    "superpixels",
    "features",
    "predict",
    "undistort",
    "match",
    "contours",
)
"""In the order of a table. The last one is all that is left: masks, outlines, the verdict, and in
tokt's methods its checks of the frame."""
REST = STAGES[-1]

Float = NDArray[np.float64]
Image = NDArray[np.uint8]
T = TypeVar("T")


class Laps:
    """Seconds of the stages of one run."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self._last = time.thread_time()

    def lap(self, stage: str) -> None:
        """Count the time since the last lap, but for what was counted inside it, for a stage."""
        now = time.thread_time()
        self.seconds[stage] += now - self._last
        self._last = now

    def inside(self, stage: str, call: Callable[[], T]) -> T:
        """Do something in the middle of another stage, and count it for this one."""
        began = time.thread_time()
        done = call()
        took = time.thread_time() - began
        self.seconds[stage] += took
        self._last += took
        return done

    def split_off(self, stage: str, call: Callable[[], T], less_s: float = 0.0) -> T:
        """Do again what was a part of `REST`, and count the time it takes for this stage.

        For a part of a call that cannot be looked into: the total stays that of the one call.

        Parameters
        ----------
        stage : str
        call : callable
        less_s : float
            Seconds of `call` that were split off already.
        """
        began = time.thread_time()
        done = call()
        took = max(0.0, time.thread_time() - began - less_s)
        took = min(took, self.seconds[REST])
        self.seconds[stage] += took
        self.seconds[REST] -= took
        self._last = time.thread_time()
        return done


class EncodedPair(NamedTuple):
    """A frame, or a pair, as it lies on the disk."""

    number: int
    left: bytes
    right: bytes | None


@dataclass(frozen=True)
class TimedMethod:
    """One method of judging a frame, to be timed.

    Parameters
    ----------
    key, title, kind : str
        Kind as in `curves`.
    run : callable
        Judges an `EncodedPair`, and tells `Laps` about it.
    """

    key: str
    title: str
    kind: str
    run: Callable[[EncodedPair, Laps], Verdict]


@dataclass(frozen=True)
class StageTimes:
    """Times of one method, stage by stage.

    Parameters
    ----------
    method : TimedMethod
    seconds : array of float64, shape (n_runs, n_stages)
        A run is one frame; runs are in the same order for all methods.
    verdicts : tuple of Verdict
        Of each frame, in the order of the frames.
    """

    method: TimedMethod
    seconds: Float
    verdicts: tuple[Verdict, ...]

    @property
    def total_ms(self) -> Float:
        """(n_runs,)"""
        return np.asarray(self.seconds.sum(axis=1) * 1e3)

    @property
    def stage_ms(self) -> pd.Series:
        """Medians, by stage."""
        return pd.Series(np.median(self.seconds, axis=0) * 1e3, list(STAGES))


def time_stages(
    methods: Sequence[TimedMethod],
    frames: Sequence[EncodedPair],
    progress: Callable[[Iterable[int], int, str], Iterable[Any]],
) -> list[StageTimes]:
    """Time each method on each frame once, the methods in turns.

    One after another the methods get different frames, as in `speed.paired_timing`: one
    that the method before has just read would come from the cache.

    Parameters
    ----------
    methods : sequence of TimedMethod
    frames : sequence of EncodedPair
    progress : callable
    """
    count = len(frames)
    shift = max(1, count // len(methods))
    seconds = {method.key: np.zeros((count, len(STAGES))) for method in methods}
    # A warm-up, not timed: imports, caches, lazily made tables.
    verdicts = {method.key: [method.run(frames[0], Laps())] * count for method in methods}
    gc.disable()
    try:
        for at in progress(range(count), count, "run times"):
            for place, method in enumerate(methods):
                index = (at + place * shift) % count
                laps = Laps()
                verdicts[method.key][index] = method.run(frames[index], laps)
                seconds[method.key][index] = [laps.seconds[stage] for stage in STAGES]
    finally:
        gc.enable()
    return [
        StageTimes(method, seconds[method.key], tuple(verdicts[method.key])) for method in methods
    ]


def _decoded(data: bytes, laps: Laps) -> Image:
    image = decode_image(data, "a frame")
    laps.lap("decode")
    return image


def thesis_texture(model: ThesisModel) -> TimedMethod:
    """The thesis's way on the grid: a library call and a predict call a patch."""

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        frame = _decoded(item.left, laps)
        gray = resized_gray(frame)
        laps.lap("resize")
        rows = [model.describe(patch) for patch in GRID.cells(gray)]
        laps.lap("features")
        white = [model.classifier.predict(row.reshape(1, -1))[0] == 1 for row in rows]
        laps.lap("predict")
        verdict = verdict_from_mask(GRID.paint(np.array(white), *gray.shape), "thesis")
        laps.lap(REST)
        return verdict

    return TimedMethod(model.name, f"{model.title}, 10x10 patches", THESIS, run)


class _Timed:
    """A method's describe function and classifier, their time counted for the run that is on."""

    def __init__(self, method: SlicTexture) -> None:
        self.laps, self._method = Laps(), method

    def describe(self, patch: Image) -> Float:
        return self.laps.inside("features", lambda: self._method.describe(patch))

    def predict(self, rows: Float) -> Any:
        return self.laps.inside("predict", lambda: self._method.classifier.predict(rows))


def slic_texture(method: SlicTexture, title: str) -> TimedMethod:
    """The thesis's way on superpixels. Resize and superpixels are split off by doing them again."""
    timed = _Timed(method)
    watched = SlicTexture(timed.describe, timed, method.name)

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        timed.laps = laps
        frame = _decoded(item.left, laps)
        verdict = watched.judge(frame, None, 0.0).verdict
        laps.lap(REST)
        picture = laps.split_off("resize", lambda: resized_bgr(frame))
        laps.split_off("superpixels", lambda: superpixels(picture))
        return verdict

    return TimedMethod(method.name, f"SLIC superpixels + {title}", THESIS, run)


def thesis_disparity() -> TimedMethod:
    """The thesis's disparity of a pair of 1360x1024; its parts are split off as for SLIC."""

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        left, right = _decoded(item.left, laps), _decoded(item.right or b"", laps)
        verdict = judge_pair(left, right).verdict
        laps.lap(REST)
        _split_matching(
            laps,
            lambda: (undistorted(left, LEFT_CAMERA), undistorted(right, RIGHT_CAMERA)),
            lambda: disparity_map(left, right),
        )
        return verdict

    return TimedMethod("disparity", "disparity, a pair", THESIS, run)


def tokt_texture(
    extractor: Extractor, model: LinearModel, key: str = "tokt_texture", title: str = "tokt texture"
) -> TimedMethod:
    """A texture model as tokt deploys it: its kernels, and one matrix product for all patches."""

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        frame = _decoded(item.left, laps)
        pictures = FramePictures(frame, GRID)
        gray = pictures.gray(extractor.images)
        laps.lap("resize")
        frame_fault(frame, gray, GRID)
        laps.lap(REST)
        features = extractor.describe_pictures(pictures)
        laps.lap("features")
        white = model.obstacle_patches(model.decision_values(features))
        laps.lap("predict")
        verdict = verdict_from_mask(GRID.paint(white, *gray.shape), "texture")
        laps.lap(REST)
        return verdict

    return TimedMethod(key, title, OURS, run)


def thesis_model_with_kernels(model: ThesisModel) -> TimedMethod:
    """One of the thesis's models with tokt's kernels: the same weights, the same verdicts."""
    weights = np.asarray(model.classifier.coef_, np.float64)
    bias = np.asarray(model.classifier.intercept_, np.float64)
    linear = LinearModel(weights, bias, np.zeros(1), ("ocean", "other"), (False, True))
    title = f"{model.title}, tokt's kernels"
    return tokt_texture(EXTRACTORS[model.name], linear, f"tokt_{model.name}", title)


def tokt_stereo(calibration: StereoCalibration) -> TimedMethod:
    """The disparity that tokt would run, of a pair; undistortion is rectification here."""
    detector = DisparityDetector(calibration, GRID)
    policy = SinglePolicy(detector)

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        left, right = _decoded(item.left, laps), _decoded(item.right or b"", laps)
        verdict = policy.judge(Frame(item.number, float(item.number), left, right)).verdict
        laps.lap(REST)
        rectifier = detector.rectifier
        _split_matching(
            laps,
            lambda: (rectifier.left(left), rectifier.right(right, detector.row_shift_px)),
            lambda: detector.match(left, right, detector.row_shift_px),
        )
        return verdict

    return TimedMethod("tokt_stereo", "tokt stereo, a pair", OURS, run)


def _split_matching(
    laps: Laps, rectify: Callable[[], object], rectify_and_match: Callable[[], object]
) -> None:
    """Split both off the rest; the second has the first in it once more."""
    laps.split_off("undistort", rectify)
    laps.split_off("match", rectify_and_match, less_s=laps.seconds["undistort"])
