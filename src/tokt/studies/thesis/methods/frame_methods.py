"""Methods run over a mission on many processes: frame by frame, or each in the frames' order.

Ours judge a run of frames as ``tokt run`` does, through a policy; the compared ones answer for
themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tokt.features.common.errors import FrameError
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.image_file import decode_image
from tokt.features.frames.mission import RIGHT, open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.reason import Fault, Reason
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import (
    OBSTACLE,
    STATUS_MEAN_THRESHOLD,
    Detector,
    Verdict,
    unknown_verdict,
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

JudgeNext = Callable[[Frame], Verdict]


@dataclass(frozen=True)
class FrameTask:
    """One frame, still encoded, and the methods that judge it by itself.

    Parameters
    ----------
    number : int
    left, right : bytes, bytes or None
    thesis : sequence of ThesisModel
    superpixel_methods : sequence of Baseline
    spec : dict or None
        Of tokt's extractor, whose features are computed beside the methods.
    changes : sequence of str
        Augmentations of which the features are wanted, too.
    """

    number: int
    left: bytes
    right: bytes | None
    thesis: Sequence[ThesisModel] = ()
    superpixel_methods: Sequence[Baseline] = ()
    spec: dict[str, Any] | None = None
    changes: Sequence[str] = ()


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


def judge_frames(tasks: Iterable[FrameTask], jobs: int) -> Iterator[FrameResult]:
    """Judge frames, in their order; the results do not depend on `jobs`, which is `mapped`'s."""
    return mapped(_judge, tasks, jobs)


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


def judge_sequences(
    makers: Mapping[str, Callable[[], JudgeNext]], mission: Path, jobs: int
) -> Iterator[tuple[str, pd.DataFrame]]:
    """Judge the frames of a mission in their order by each of some methods.

    Parameters
    ----------
    makers : mapping of str to callable
        By method: makes a function of the next frame. It goes to another process.
    mission : Path
    jobs : int
        As for `mapped`; the results do not depend on it.

    Returns
    -------
    iterator of (str, DataFrame)
        The method; by frame its ``status``, the ``mean`` of its 0/255 mask, 0..255, and
        ``distance_m``, of what is nearest; nan where not known.
    """
    return mapped(partial(_judge_sequence, mission), makers.items(), jobs)


def _judge_sequence(
    folder: Path, method: tuple[str, Callable[[], JudgeNext]]
) -> tuple[str, pd.DataFrame]:
    cv2.setNumThreads(1)
    mission, (name, make) = open_mission(folder), method
    judge, rows = make(), {}
    for frame in MissionSource(mission, SYSTEM_CLOCK, stereo=RIGHT in mission.cameras):
        verdict = judge(frame)
        rows[frame.number] = verdict.status, verdict.mean, verdict.distance_m
    found = pd.DataFrame.from_dict(rows, orient="index", columns=["status", "mean", "distance_m"])
    return name, found.astype({"mean": float, "distance_m": float})


def stereo_judge(calibration: StereoCalibration) -> JudgeNext:
    """Our stereo."""
    return _by_policy(DisparityDetector(calibration, GRID))


def bundle_judge(file: Path) -> JudgeNext:
    """A texture model's bundle."""
    return _by_policy(TextureDetector(read_bundle(file)))


def _by_policy(detector: Detector) -> JudgeNext:
    policy = SinglePolicy(detector)
    return lambda frame: policy.judge(frame).verdict


def thirds_judge(calibration: StereoCalibration) -> JudgeNext:
    """The thirds of disparity."""
    return _by_baseline(Thirds(calibration), pair=True)


def size_change_judge() -> JudgeNext:
    """Growing keypoints."""
    return _by_baseline(SizeChange(), pair=False)


def _by_baseline(method: Baseline, pair: bool) -> JudgeNext:
    def judge(frame: Frame) -> Verdict:
        if frame.left is None or (pair and frame.right is None):
            return unknown_verdict(Fault(Reason.MISSING, "a picture of it cannot be read"))
        return method.judge(frame.left, frame.right, float(frame.number)).verdict

    return judge
