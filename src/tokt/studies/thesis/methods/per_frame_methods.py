"""Methods that judge each frame by itself, run over a mission on many processes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import FrameError
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.image_file import decode_image
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.verdict import OBSTACLE, STATUS_MEAN_THRESHOLD, verdict_from_mask
from tokt.studies.baselines.baseline import Baseline
from tokt.studies.baselines.thesis_models import ThesisModel
from tokt.studies.baselines.thesis_stereo import THESIS_FRAME_SIZE, judge_pair
from tokt.studies.baselines.thesis_texture import GRID
from tokt.training.datasets.augmentations import augment
from tokt.training.parallel import mapped

THESIS_DISPARITY = "disparity"


@dataclass(frozen=True)
class Extraction:
    """tokt's features that are computed beside the methods.

    Parameters
    ----------
    spec : dict
        The extractor's.
    changes : tuple of str
        Augmentations, after the frame as it is.
    """

    spec: dict[str, Any]
    changes: tuple[str, ...]


@dataclass(frozen=True)
class FrameMethods:
    """The methods that judge a mission's frames, each by itself.

    Parameters
    ----------
    thesis : sequence of ThesisModel
    slow : mapping of int to sequence of Baseline
        Further methods, by frame: only those of a sample have some.
    extraction : Extraction or None
    learnt_from : frozenset of int
        The frames whose features are wanted of augmented frames, too.
    """

    thesis: Sequence[ThesisModel]
    superpixel_methods: Mapping[int, Sequence[Baseline]] = field(default_factory=dict)
    extraction: Extraction | None = None
    learnt_from: frozenset[int] = frozenset()


@dataclass(frozen=True)
class FrameTask:
    """One frame, still encoded, and what to do with it."""

    number: int
    left: bytes
    right: bytes | None
    thesis: Sequence[ThesisModel]
    superpixel_methods: Sequence[Baseline]
    extraction: Extraction | None


@dataclass(frozen=True)
class FrameResult:
    """The methods' results for one frame.

    Parameters
    ----------
    number : int
    size : (height, width)
        Of the frame, in pixels.
    fault : str
        Why the frame could not be judged at all; empty where it was.
    mean : dict of str to float
        By method: of the 0/255 mask, 0..255.
    status : dict of str to int
    patches : dict of str to array of bool, shape (n_patches,)
        Of the thesis's texture methods: the patches that are not ocean.
    features : list of array of float64, shape (n_patches, dim)
        Of our own extractor: of the frame as it is, then as each change makes it.
    """

    number: int
    size: tuple[int, int] = (0, 0)
    fault: str = ""
    mean: dict[str, float] = field(default_factory=dict)
    status: dict[str, int] = field(default_factory=dict)
    patches: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    features: list[NDArray[np.float64]] = field(default_factory=list)


def judge_frames(
    mission: Mission, numbers: Sequence[int], judges: FrameMethods, jobs: int
) -> Iterator[FrameResult]:
    """Judge frames, in their order.

    Parameters
    ----------
    mission : Mission
    numbers : sequence of int
        Its left frames.
    judges : FrameMethods
    jobs : int
        As for `mapped`; the results do not depend on it.
    """
    return mapped(_judge, _tasks(mission, numbers, judges), jobs)


def _tasks(mission: Mission, numbers: Iterable[int], judges: FrameMethods) -> Iterator[FrameTask]:
    rights = set(mission.frames(RIGHT))
    for number in numbers:
        right = mission.encoded(number, RIGHT)[0] if number in rights else None
        extraction = judges.extraction
        if extraction is not None and number not in judges.learnt_from:
            extraction = Extraction(extraction.spec, ())
        yield FrameTask(
            number,
            mission.encoded(number, LEFT)[0],
            right,
            judges.thesis,
            judges.superpixel_methods.get(number, ()),
            extraction,
        )


def _judge(task: FrameTask) -> FrameResult:
    cv2.setNumThreads(1)
    try:
        left = decode_image(task.left, f"frame {task.number}")
    except FrameError as error:
        return FrameResult(task.number, fault=str(error))
    found = FrameResult(task.number, (left.shape[0], left.shape[1]))
    for model in task.thesis:
        judged = model.judge(left)
        found.mean[model.name] = float(judged.verdict.mean or 0.0)
        found.status[model.name] = judged.verdict.status
        found.patches[model.name] = judged.obstacle
    _judge_pair(task, left, found)
    for method in task.superpixel_methods:
        verdict = method.judge(left, None, float(task.number)).verdict
        found.mean[method.name] = float("nan") if verdict.mean is None else verdict.mean
        found.status[method.name] = verdict.status
    found.features.extend(_features(task, left))
    return found


def _judge_pair(task: FrameTask, left: NDArray[np.uint8], found: FrameResult) -> None:
    """The thesis's disparity, on frames of the size that its numbers are for."""
    if task.right is None or left.shape[1::-1] != THESIS_FRAME_SIZE:
        return
    try:
        right = decode_image(task.right, f"right frame {task.number}")
    except FrameError:
        return
    if right.shape[1::-1] == THESIS_FRAME_SIZE:
        mean = judge_pair(left, right).mean
        found.mean[THESIS_DISPARITY] = mean
        found.status[THESIS_DISPARITY] = OBSTACLE if mean > STATUS_MEAN_THRESHOLD else 0


def _features(task: FrameTask, left: NDArray[np.uint8]) -> Iterator[NDArray[np.float64]]:
    extraction = task.extraction
    if extraction is None:
        return
    extractor = build_extractor(extraction.spec)
    yield extractor.describe(left, GRID)
    for name in extraction.changes:
        yield extractor.describe(augment(left, name), GRID)


def mean_and_status(
    white: NDArray[np.bool_], size: tuple[int, int], method: str
) -> tuple[float, int]:
    """Mean (0..255) and status of white patches in a frame of (height, width) pixels."""
    verdict = verdict_from_mask(GRID.paint(white, *GRID.resized(*size)), method)
    return float(verdict.mean or 0.0), verdict.status
