"""Mean value and status of every frame by every method: what figures 5.3 to 5.5 are drawn from.

Methods run over a mission on many processes: frame by frame, or each in the frames' order. Ours
judge a run of frames as ``tokt run`` does, through a policy; the compared ones answer for
themselves.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import pandas as pd

from tokt.features.common.arrays import F64, U8, Bools
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.image_file import decode_image, pixel_sha256
from tokt.features.frames.mission import LEFT, RIGHT, open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.reason import Fault, Reason
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import (
    OBSTACLE,
    STATUS_MEAN_THRESHOLD,
    UNKNOWN,
    Detector,
    Verdict,
    unknown_verdict,
)
from tokt.models.bundle.bundle import frame_id, read_bundle
from tokt.studies.baselines.baseline import Baseline
from tokt.studies.baselines.mean_disparity import Thirds
from tokt.studies.baselines.size_change import SizeChange
from tokt.studies.baselines.slic import SlicTexture
from tokt.studies.baselines.thesis_models import TITLES, ThesisModel
from tokt.studies.baselines.thesis_stereo import THESIS_FRAME_SIZE, judge_pair
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.datasets.augmentations import augment
from tokt.training.fitting.presets import (
    DEFAULT_EXTRACTOR,
    TrainingSettings,
    extractor_for,
    settings_named,
)
from tokt.training.parallel import mapped

from .mission_models import PRESET, SLIC, TOKT_TEXTURE, SuperpixelMethods, held_out_texture

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
    patches: dict[str, Bools] = field(default_factory=dict)
    features: list[F64] = field(default_factory=list)


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


def _judge_pair(task: FrameTask, left: U8, found: FrameResult) -> None:
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


def _by_policy(make: Callable[..., Detector], *given: Any) -> JudgeNext:
    """A detector of ours as ``tokt run`` asks it."""
    policy = SinglePolicy(make(*given))
    return lambda frame: policy.judge(frame).verdict


def _model_of(file: Path) -> TextureDetector:
    return TextureDetector(read_bundle(file))


def _by_baseline(make: type[Thirds] | type[SizeChange], *given: Any) -> JudgeNext:
    method = make(*given)

    def judge(frame: Frame) -> Verdict:
        if frame.left is None or (make is Thirds and frame.right is None):
            return unknown_verdict(Fault(Reason.MISSING, "a picture of it cannot be read"))
        return method.judge(frame.left, frame.right, float(frame.number)).verdict

    return judge


THESIS, COMPARED, OURS = "the thesis's", "compared with", "tokt's"
SLIC_TITLES = {f"slic_{name}": f"SLIC + {TITLES[name]}" for name in SLIC}


@dataclass(frozen=True)
class Method:
    """One way of judging frames.

    Parameters
    ----------
    title : str
        For legends and tables.
    kind : str
        `THESIS`, `COMPARED` or `OURS`.
    words : str
        What it is, and what it learnt from.
    sampled : bool
        Whether it judged a sample of the frames only.
    """

    title: str
    kind: str
    words: str
    sampled: bool = False


@dataclass
class Curves:
    """Curves by frame.

    Parameters
    ----------
    mean, status : DataFrame
        Index ``frame``: the frames that are scored, in order. A column a method. Mean of the
        0/255 mask, 0..255, nan where the method did not judge the frame; status 1, 0, or -1
        where it did not judge it.
    methods : dict of str to Method
        By column.
    patches : dict of str to dict of int to array of bool, shape (n_patches,)
        Of the texture methods on the grid, by frame: the patches that are not ocean.
    distance_m : Series
        Near end of the matched depths, metres; nan where nothing is measured.
    left_out : list of str
        Which methods could not be run, and why.
    unreadable : tuple of int
        Frames that could not be read.
    """

    mean: pd.DataFrame
    status: pd.DataFrame
    methods: dict[str, Method]
    patches: dict[str, dict[int, Bools]] = field(default_factory=dict)
    distance_m: pd.Series = field(default_factory=lambda: pd.Series(dtype=float))
    left_out: list[str] = field(default_factory=list)
    unreadable: tuple[int, ...] = ()

    def add(
        self,
        name: str,
        method: Method,
        mean: pd.Series | dict[int, float],
        status: pd.Series | dict[int, int],
    ) -> None:
        """Add a method's means and statuses by frame; others than the curves' are left out."""
        self.mean[name] = pd.Series(mean, dtype=float).reindex(self.mean.index)
        said = pd.Series(status, dtype="Int64").reindex(self.status.index)
        self.status[name] = said.fillna(UNKNOWN).astype(int)
        self.methods[name] = method

    def named(self, kind: str) -> list[str]:
        """The methods of a kind."""
        return [name for name, method in self.methods.items() if method.kind == kind]

    def highest(self) -> int:
        """The frame whose means, each curve's as a share of its largest, are highest together."""
        whole = [name for name, method in self.methods.items() if not method.sampled]
        return int(self.shares()[whole].mean(axis=1).idxmax())

    def shares(self) -> pd.DataFrame:
        """The means, each curve's as a share of its largest; a curve of zeros stays one."""
        return self.mean / self.mean.max().replace(0.0, 1.0)


def measure_curves(inputs: StudyInputs, superpixel_methods: SuperpixelMethods) -> Curves:
    """Judge every scored frame by every method.

    What was learnt from one frame is not scored on it: the thesis's models and the compared ones
    learn from two images, and a mission's frame among these is not scored; ours is held out
    (`held_out_texture`). SLIC and superpixel colours judge a sample of the frames.
    """
    settings = settings_named(PRESET) if inputs.obstacle_patches else None
    sample, numbers = inputs.spread(), inputs.scored
    tasks = _frame_tasks(inputs, {n: superpixel_methods.of(n) for n in sample}, settings)
    found = judge_frames(tasks, inputs.request.jobs)
    judged = list(inputs.progress(found, len(numbers), "curves, frame by frame"))
    readable = [one for one in judged if not one.fault]
    index = pd.Index([one.number for one in readable], name="frame")
    curves = Curves(pd.DataFrame(index=index), pd.DataFrame(index=index), {})
    curves.unreadable = tuple(one.number for one in judged if one.fault)
    _add_thesis(curves, inputs, readable)
    _add_slow(curves, superpixel_methods, sample, readable)
    _add_texture(curves, inputs, settings, readable)
    _add_runs(curves, inputs)
    return curves


def _frame_tasks(
    inputs: StudyInputs, slow: Mapping[int, Sequence[Baseline]], settings: TrainingSettings | None
) -> Iterator[FrameTask]:
    """What is to be done with each scored frame; `slow` are the methods of a sample of them."""
    mission, rights = inputs.mission, set(inputs.pairs)
    spec = extractor_for(DEFAULT_EXTRACTOR, PRESET).spec if settings else None
    for number in inputs.scored:
        yield FrameTask(
            number,
            mission.encoded(number, LEFT)[0],
            mission.encoded(number, RIGHT)[0] if number in rights else None,
            list(inputs.thesis.values()),
            slow.get(number, ()),
            spec,
            settings.changes if settings and number in inputs.obstacle_patches else (),
        )


def _add_judged(curves: Curves, name: str, method: Method, readable: Sequence[FrameResult]) -> None:
    """A method that judged the frames one by one."""
    by_it = [one for one in readable if name in one.mean]
    means = {one.number: one.mean[name] for one in by_it}
    curves.add(name, method, means, {one.number: one.status[name] for one in by_it})


def _add_thesis(curves: Curves, inputs: StudyInputs, readable: Sequence[FrameResult]) -> None:
    """The thesis's texture models, and its disparity."""
    for name, model in inputs.thesis.items():
        words = f"{model.title} as the thesis has it, {inputs.two_images}"
        _add_judged(curves, name, Method(model.title, THESIS, words), readable)
        curves.patches[name] = {one.number: one.patches[name] for one in readable}
    if any(THESIS_DISPARITY in one.mean for one in readable):
        words = (
            "the thesis's disparity pipeline (not rectified, stretched to 0..255, cropped by "
            "200 px at either side); it learns nothing"
        )
        _add_judged(curves, THESIS_DISPARITY, Method("disparity", THESIS, words), readable)
    elif not inputs.pairs:
        curves.left_out.append("the thesis's disparity: the mission has no right frames")
    else:
        size = "x".join(map(str, THESIS_FRAME_SIZE))
        curves.left_out.append(f"the thesis's disparity: its numbers are for frames of {size}")


def _add_slow(
    curves: Curves,
    methods: SuperpixelMethods,
    sample: Sequence[int],
    readable: Sequence[FrameResult],
) -> None:
    """The methods on superpixels."""
    for one in methods.of(sample[0]):
        kind = THESIS if isinstance(one, SlicTexture) else COMPARED
        words = (
            f"{one.title} ({one.source}), {methods.words(one)}; on a sample of {len(sample)} "
            "frames, as it is slow"
        )
        title = SLIC_TITLES.get(one.name, one.title)
        _add_judged(curves, one.name, Method(title, kind, words, sampled=True), readable)


def _add_texture(
    curves: Curves,
    inputs: StudyInputs,
    settings: TrainingSettings | None,
    readable: Sequence[FrameResult],
) -> None:
    """Our texture model, held out; without settings there is nothing to learn from."""
    try:
        if settings is None:
            raise ToktError("there are no labels to learn from")
        features = {one.number: one.features for one in readable}
        sizes = {one.number: one.size for one in readable}
        found = held_out_texture(inputs, features, sizes, settings)
    except ToktError as error:
        curves.left_out.append(f"tokt's texture model: {error}")
        return
    method = Method("tokt texture, held out", OURS, found.words)
    curves.add(TOKT_TEXTURE, method, found.mean, found.status)
    curves.patches[TOKT_TEXTURE] = found.patches


def _add_runs(curves: Curves, inputs: StudyInputs) -> None:
    """The methods that look at frames in their order, and the distances that stereo measures."""
    calibration, cameras = inputs.calibration, inputs.calibration_words
    # The one that takes longest first, so that the others run beside it.
    words = "growing keypoints (Mori and Scherer 2013): frames against earlier ones; learns nothing"
    methods = {SIZE_CHANGE: Method("growing keypoints", COMPARED, words)}
    makers: dict[str, Callable[[], JudgeNext]] = {SIZE_CHANGE: partial(_by_baseline, SizeChange)}
    if calibration is None:
        curves.left_out.append(f"tokt's stereo, and thirds: {cameras}")
    else:
        words = (
            "left, centre and right mean disparity (Kostavelis and others 2009) on tokt's "
            f"rectified disparity, with {cameras}; learns nothing"
        )
        methods[MEAN_DISPARITY] = Method("thirds of disparity", COMPARED, words)
        makers[MEAN_DISPARITY] = partial(_by_baseline, Thirds, calibration)
        ours = "tokt's rectified disparity as tokt run has it"
        words = f"{ours}, with {cameras}; learns no frames' looks"
        methods[TOKT_STEREO] = Method("tokt stereo", OURS, words)
        makers[TOKT_STEREO] = partial(_by_policy, DisparityDetector, calibration, GRID)
    if inputs.request.model is not None:
        methods[TOKT_MODEL] = _model_method(inputs)
        makers[TOKT_MODEL] = partial(_by_policy, _model_of, inputs.request.model)
    runs = judge_sequences(makers, inputs.mission.path, inputs.request.jobs)
    for name, found in inputs.progress(runs, len(makers), "curves, in order of frames"):
        curves.add(name, methods[name], found["mean"], found.status)
        if name == TOKT_STEREO:
            curves.distance_m = found.distance_m
    curves.distance_m = curves.distance_m.reindex(curves.mean.index)


def _model_method(inputs: StudyInputs) -> Method:
    """The bundle that was given; it is said where it learnt from these very frames."""
    bundle = read_bundle(str(inputs.request.model))
    known = set(bundle.content.trained_on.tolist())
    # All of them: a model that learnt from a few has seen near copies of the others.
    there = inputs.decoded(inputs.frames)
    learnt = sum(int(frame_id(pixel_sha256(image))) in known for _, image in there)
    title = f"tokt model {bundle.label}"
    split = "it learnt from none of these frames"
    if learnt:
        split = f"NOT held out: it learnt from {learnt} of these frames"
    elif not known:
        split = "it does not say what it learnt from, so it may not be held out"
    return Method(title, OURS, f"the model {bundle.label} as given; {split}")
