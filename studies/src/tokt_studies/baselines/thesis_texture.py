"""The thesis's pipeline with the libraries it used: what tokt is measured against.

Resize, gray, then for each patch one library call and one predict call, then contours. The
verdict is the corrected one (`tokt.inference.verdict`), so that both sides can be held against
each other.

Run as ``python -m tokt_studies.baselines.thesis_texture MODEL FRAME PORT`` it judges one frame and
sends the verdict to 127.0.0.1 as one v1 datagram; the model is a joblib file of a LinearSVC on
LBP (10, 5). `tokt bench` times that process, so this file imports little.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import mahotas.features
import numpy as np
from skimage.feature import local_binary_pattern

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.frames.grid import Grid
from tokt.inference.verdict import Verdict, verdict_from_mask

GRID = Grid(10, 10, 360)

DescribePatch = Callable[[U8], F64]


def lbp_counts(patch: U8, points: int, radius: int) -> I64:
    """How often each uniform pattern is in a patch: int64, shape (points + 2,)."""
    codes = local_binary_pattern(patch, points, radius, method="uniform")
    return np.histogram(codes, bins=points + 2, range=(0, points + 2))[0]


def haralick_directions(patch: U8, ignore_zeros: bool) -> F64:
    """Haralick's 13 features in each of 4 directions: float64, shape (4, 13).

    Where no pair of pixels is left without grey level 0, mahotas refuses (and the thesis's
    program ended); then the zeros are counted.
    """
    try:
        return np.asarray(mahotas.features.haralick(patch, ignore_zeros=ignore_zeros))
    except ValueError:
        return np.asarray(mahotas.features.haralick(patch))


def describe_lbp(patch: U8, points: int, radius: int) -> F64:
    """Normalised histogram of LBP (points, radius)."""
    counts = lbp_counts(patch, points, radius)
    return counts / float(counts.sum())


describe_lbp_10_5 = partial(describe_lbp, points=10, radius=5)
describe_lbp_24_8 = partial(describe_lbp, points=24, radius=8)


def describe_haralick(patch: U8) -> F64:
    """Haralick's 13 features, mean over the directions, without grey level 0."""
    mean: F64 = haralick_directions(patch, ignore_zeros=True).mean(axis=0)
    return mean


DESCRIBE: dict[str, DescribePatch] = {
    "lbp_10_5": describe_lbp_10_5,
    "lbp_24_8": describe_lbp_24_8,
    "haralick": describe_haralick,
}


def resized_gray(frame: U8) -> U8:
    """The frame at the grid's width, then gray."""
    height, width = GRID.resized(*frame.shape[:2])
    small = np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA))
    if small.ndim == 3:
        small = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY))
    return small.astype(np.uint8, copy=False)


@dataclass(frozen=True)
class ThesisTextureResult:
    """The patches (n_patches,) of one frame that are an obstacle, and the verdict on it."""

    obstacle: Bools
    verdict: Verdict


def judge(frame: U8, describe: DescribePatch, classifier: Any) -> ThesisTextureResult:
    """Judge a decoded frame, (height, width) or (height, width, 3), patch by patch.

    The classifier, scikit-learn's LinearSVC, predicts 1 for an obstacle.
    """
    gray = resized_gray(frame)
    rows = (describe(gray[y0:y1, x0:x1]) for y0, y1, x0, x1 in GRID.boxes(*gray.shape))
    obstacle = np.array([classifier.predict(row.reshape(1, -1))[0] == 1 for row in rows])
    verdict = verdict_from_mask(GRID.paint(obstacle, *gray.shape), "thesis")
    return ThesisTextureResult(obstacle, verdict)


def main(model: str, frame: str, port: str) -> None:
    """Load, look, judge, send."""
    import socket

    import joblib

    from tokt.inference.outputs.udp import encode_v1

    classifier = joblib.load(model)
    picture = np.asarray(cv2.imread(frame, cv2.IMREAD_ANYCOLOR), np.uint8)
    datagram = encode_v1(judge(picture, describe_lbp_10_5, classifier).verdict)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(datagram or b"", ("127.0.0.1", int(port)))


if __name__ == "__main__":
    main(*sys.argv[1:])
