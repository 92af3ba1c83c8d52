"""Methods that judge frames in their order, each run over a mission in its own process.

Ours judge as ``tokt run`` does, through a policy; the compared ones answer for themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tokt.features.frames.mission import RIGHT, open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import UNKNOWN, Detector, Verdict
from tokt.models.bundle.bundle import read_bundle
from tokt.studies.baselines.baseline import Baseline
from tokt.studies.baselines.mean_disparity import Thirds
from tokt.studies.baselines.size_change import SizeChange
from tokt.studies.baselines.thesis_texture import GRID
from tokt.training.parallel import mapped

TOKT_STEREO, TOKT_MODEL = "tokt_stereo", "tokt_model"
MEAN_DISPARITY, SIZE_CHANGE = Thirds.name, SizeChange.name


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
    mean: dict[int, float]
    status: dict[int, int]
    distance_m: dict[int, float]


def judge_sequences(tasks: Sequence[SequenceTask], jobs: int) -> Iterator[SequenceResult]:
    """Judge the frames of a mission by each of some methods; the results do not depend on jobs."""
    return mapped(_judge, tasks, jobs)


def _judge(task: SequenceTask) -> SequenceResult:
    cv2.setNumThreads(1)
    found = SequenceResult(task.method, {}, {}, {})
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
