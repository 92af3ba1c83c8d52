"""Methods run over a mission on many processes: frame by frame, or each in the frames' order.

Ours judge a run of frames as ``tokt run`` does, through a policy; the compared ones answer for
themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import FrameError
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.image_file import decode_image
from tokt.features.frames.mission import LEFT, RIGHT, Mission, open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import (
    OBSTACLE,
    STATUS_MEAN_THRESHOLD,
    UNKNOWN,
    Detector,
    Verdict,
    verdict_from_mask,
)
from tokt.models.bundle.bundle import read_bundle
from tokt.studies.baselines.baseline import Baseline
from tokt.studies.baselines.mean_disparity import Thirds
from tokt.studies.baselines.size_change import SizeChange
from tokt.studies.baselines.thesis_models import ThesisModel
from tokt.studies.baselines.thesis_stereo import THESIS_FRAME_SIZE, judge_pair
from tokt.studies.baselines.thesis_texture import GRID
from tokt.training.datasets.augmentations import augment
from tokt.training.parallel import mapped

THESIS_DISPARITY = "disparity"
TOKT_STEREO, TOKT_MODEL = "tokt_stereo", "tokt_model"
MEAN_DISPARITY, SIZE_CHANGE = Thirds.name, SizeChange.name


@dataclass(frozen=True)
class FrameMethods:
    """The methods that judge a mission's frames, each by itself.

    Parameters
    ----------
    thesis : sequence of ThesisModel
    superpixel_methods : mapping of int to sequence of Baseline
        Further methods, by frame: only those of a sample have some.
    spec : dict or None
        Of tokt's extractor, whose features are computed beside the methods.
    changes : tuple of str
        Augmentations of which the features are wanted, too.
    learnt_from : frozenset of int
        The frames of which these are.
    """

    thesis: Sequence[ThesisModel]
    superpixel_methods: Mapping[int, Sequence[Baseline]] = field(default_factory=dict)
    spec: dict[str, Any] | None = None
    changes: tuple[str, ...] = ()
    learnt_from: frozenset[int] = frozenset()


@dataclass(frozen=True)
class FrameTask:
    """One frame, still encoded, and what to do with it."""

    number: int
    left: bytes
    right: bytes | None
    thesis: Sequence[ThesisModel] = ()
    superpixel_methods: Sequence[Baseline] = ()
    spec: dict[str, Any] | None = None
    changes: tuple[str, ...] = ()


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
        yield FrameTask(
            number,
            mission.encoded(number, LEFT)[0],
            mission.encoded(number, RIGHT)[0] if number in rights else None,
            judges.thesis,
            judges.superpixel_methods.get(number, ()),
            judges.spec,
            judges.changes if number in judges.learnt_from else (),
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
    if task.spec is not None:
        extractor = build_extractor(task.spec)
        pictures = (left, *(augment(left, name) for name in task.changes))
        found.features.extend(extractor.describe(picture, GRID) for picture in pictures)
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


def mean_and_status(
    white: NDArray[np.bool_], size: tuple[int, int], method: str
) -> tuple[float, int]:
    """Mean (0..255) and status of white patches in a frame of (height, width) pixels."""
    verdict = verdict_from_mask(GRID.paint(white, *GRID.resized(*size)), method)
    return float(verdict.mean or 0.0), verdict.status


@dataclass(frozen=True)
class SequenceTask:
    """A mission's frames by one method.

    Parameters
    ----------
    method : str
        `TOKT_STEREO`, `TOKT_MODEL`, `MEAN_DISPARITY` or `SIZE_CHANGE`.
    mission : Path
    calibration : StereoCalibration or None
        For the methods that need one.
    bundle : Path or None
        For `TOKT_MODEL`.
    """

    method: str
    mission: Path
    calibration: StereoCalibration | None = None
    bundle: Path | None = None


@dataclass(frozen=True)
class SequenceResult:
    """A method's results for a mission's frames.

    Parameters
    ----------
    method : str
    mean, distance_m : dict of int to float
        By frame: of the 0/255 mask, 0..255; distance of what is nearest. nan where not known.
    status : dict of int to int
    """

    method: str
    mean: dict[int, float] = field(default_factory=dict)
    status: dict[int, int] = field(default_factory=dict)
    distance_m: dict[int, float] = field(default_factory=dict)


def judge_sequences(tasks: Sequence[SequenceTask], jobs: int) -> Iterator[SequenceResult]:
    """Judge the frames of a mission by each of some methods; the results do not depend on jobs."""
    return mapped(_judge_sequence, tasks, jobs)


def _judge_sequence(task: SequenceTask) -> SequenceResult:
    cv2.setNumThreads(1)
    found = SequenceResult(task.method)
    mission = open_mission(task.mission)
    judge = _judge_of(task)
    for frame in MissionSource(mission, SYSTEM_CLOCK, stereo=RIGHT in mission.cameras):
        verdict = judge(frame)
        found.status[frame.number] = UNKNOWN if verdict is None else verdict.status
        mean, distance = (None, None) if verdict is None else (verdict.mean, verdict.distance_m)
        found.mean[frame.number] = np.nan if mean is None else mean
        found.distance_m[frame.number] = np.nan if distance is None else distance
    return found


def _judge_of(task: SequenceTask) -> Callable[[Frame], Verdict | None]:
    """The method as a function of the next frame; None where the frame cannot be read."""
    calibration, bundle = task.calibration, task.bundle
    if task.method == TOKT_STEREO and calibration is not None:
        return _by_policy(DisparityDetector(calibration, GRID))
    if task.method == TOKT_MODEL and bundle is not None:
        return _by_policy(TextureDetector(read_bundle(bundle)))
    if task.method == MEAN_DISPARITY and calibration is not None:
        return _by_baseline(Thirds(calibration), pair=True)
    if task.method == SIZE_CHANGE:
        return _by_baseline(SizeChange(), pair=False)
    raise ValueError(f"{task.method} cannot judge a run with what it was given")


def _by_policy(detector: Detector) -> Callable[[Frame], Verdict | None]:
    policy = SinglePolicy(detector)
    return lambda frame: policy.judge(frame).verdict


def _by_baseline(method: Baseline, pair: bool) -> Callable[[Frame], Verdict | None]:
    def judge(frame: Frame) -> Verdict | None:
        if frame.left is None or (pair and frame.right is None):
            return None
        return method.judge(frame.left, frame.right, float(frame.number)).verdict

    return judge
