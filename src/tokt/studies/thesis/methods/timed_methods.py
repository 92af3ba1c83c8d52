"""The methods that the run-time tables compare, each timed stage by stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.svm import LinearSVC

from tokt.features.extractors.extractor import Extractor, Haralick, Lbp
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.frames.image_file import decode_image
from tokt.inference.frame import Frame
from tokt.inference.frame_checks import frame_fault
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import Verdict, verdict_from_mask
from tokt.models.linear import LinearModel
from tokt.studies.baselines.slic import SlicTexture
from tokt.studies.baselines.superpixels import resized_bgr, superpixels
from tokt.studies.baselines.thesis_models import ThesisModel
from tokt.studies.baselines.thesis_stereo import (
    LEFT_CAMERA,
    RIGHT_CAMERA,
    disparity_map,
    judge_pair,
)
from tokt.studies.baselines.thesis_texture import GRID, DescribePatch, resized_gray
from tokt.studies.thesis.methods.curves import OURS, THESIS

from .stage_clock import REST, EncodedPair, Laps, TimedMethod

Image = NDArray[np.uint8]
_EXTRACTORS: dict[str, Extractor] = {
    "lbp_10_5": Lbp(10, 5, "patch"),
    "lbp_24_8": Lbp(24, 8, "patch"),
    "haralick": Haralick(ignore_zeros=True),
}


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
    """A describe function and a classifier that count their time for the run that is on."""

    def __init__(self, describe: DescribePatch, classifier: LinearSVC) -> None:
        self.laps = Laps()
        self._describe, self._classifier = describe, classifier

    def describe(self, patch: Image) -> NDArray[np.float64]:
        return self.laps.inside("features", lambda: self._describe(patch))

    def predict(self, rows: NDArray[np.float64]) -> Any:
        return self.laps.inside("predict", lambda: self._classifier.predict(rows))


def slic_texture(method: SlicTexture, title: str) -> TimedMethod:
    """The thesis's way on superpixels. Resize and superpixels are split off by doing them again."""
    timed = _Timed(method.describe, method.classifier)
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
        _split_matching(laps, lambda: _undistort(left, right), lambda: disparity_map(left, right))
        return verdict

    return TimedMethod("disparity", "disparity, a pair", THESIS, run)


def _undistort(left: Image, right: Image) -> None:
    for frame, (fx, fy, distortion) in ((left, LEFT_CAMERA), (right, RIGHT_CAMERA)):
        gray = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        cv2.undistort(gray, np.diag([fx, fy, 1.0]), np.array(distortion))


@dataclass(frozen=True)
class _Texture:
    """Features of tokt's kernels and one matrix product for all patches."""

    extractor: Extractor
    model: LinearModel

    def run(self, item: EncodedPair, laps: Laps) -> Verdict:
        frame = _decoded(item.left, laps)
        pictures = FramePictures(frame, GRID)
        gray = pictures.gray(self.extractor.images)
        laps.lap("resize")
        frame_fault(frame, gray, GRID)
        laps.lap(REST)
        features = self.extractor.describe_pictures(pictures)
        laps.lap("features")
        values = self.model.decision_values(features)
        white = self.model.obstacle_patches(values)
        laps.lap("predict")
        verdict = verdict_from_mask(GRID.paint(white, *gray.shape), "texture")
        laps.lap(REST)
        return verdict


def thesis_model_with_kernels(model: ThesisModel) -> TimedMethod:
    """One of the thesis's models with tokt's kernels: the same weights, the same verdicts."""
    weights = np.asarray(model.classifier.coef_, np.float64)
    bias = np.asarray(model.classifier.intercept_, np.float64)
    linear = LinearModel(weights, bias, np.zeros(1), ("ocean", "other"), (False, True))
    ours = _Texture(_EXTRACTORS[model.name], linear)
    return TimedMethod(f"tokt_{model.name}", f"{model.title}, tokt's kernels", OURS, ours.run)


def tokt_texture(extractor: Extractor, model: LinearModel) -> TimedMethod:
    """The texture model that tokt would deploy."""
    return TimedMethod("tokt_texture", "tokt texture", OURS, _Texture(extractor, model).run)


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
