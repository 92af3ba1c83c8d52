"""Mean value and status of every frame by every method: what figures 5.3 to 5.5 are drawn from.

Methods run over a mission on many processes: frame by frame, or each in the frames' order. Ours
judge a run of frames as ``tokt run`` does, through a policy; the compared ones answer for
themselves.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import pandas as pd

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.image_file import decode_image, pixel_sha256
from tokt.features.frames.mission import LEFT, RIGHT, open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.policy.policy import Policy, SinglePolicy
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import UNKNOWN, Verdict, verdict_from_mask
from tokt.models.bundle.bundle import frame_id, read_bundle
from tokt.training.datasets.augmentations import augment
from tokt.training.fitting import presets
from tokt.training.parallel import mapped
from tokt_studies.baselines.mean_disparity import Thirds
from tokt_studies.baselines.size_change import SizeChange
from tokt_studies.baselines.thesis_models import ThesisModel
from tokt_studies.baselines.thesis_stereo import THESIS_FRAME_SIZE, THESIS_SIZE_WORDS, judge_pair
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.inputs import StudyInputs

from .mission_models import (
    PRESET,
    TOKT_TEXTURE,
    SuperpixelMethod,
    SuperpixelMethods,
    held_out_texture,
)

THESIS_DISPARITY = "disparity"
TOKT_STEREO, TOKT_MODEL = "tokt_stereo", "tokt_model"
ONE_CAMERA = SizeChange.name, TOKT_MODEL  # which is the one asked for

Settings = presets.TrainingSettings | None
MakeMethod = Callable[[], Policy]
"""Makes what judges a run of frames; it goes to another process."""


@dataclass(frozen=True)
class FrameTask:
    """One frame, still encoded, and the methods that judge it by itself.

    Features are computed beside the methods where tokt's extractor has a `spec` here: of the frame
    as it is, and as each of the `changes`, augmentations, makes it.
    """

    number: int
    left: bytes | None
    right: bytes | None
    thesis: Sequence[ThesisModel] = ()
    superpixel_methods: Sequence[SuperpixelMethod] = ()
    spec: dict[str, Any] | None = None
    changes: Sequence[str] = ()
    camera: str = LEFT  # whose picture the methods judge; the disparity takes both


@dataclass(frozen=True)
class FrameResult:
    """The methods' results for one frame of `size` (height, width), or why there are none.

    By method the mean of the 0/255 mask, 0..255, and the status; of the thesis's texture methods
    the patches that are not ocean.
    """

    number: int
    size: tuple[int, int] = (0, 0)
    fault: str = ""
    mean: dict[str, float] = field(default_factory=dict)
    status: dict[str, int] = field(default_factory=dict)
    patches: dict[str, Bools] = field(default_factory=dict)
    features: list[F64] = field(default_factory=list)

    def add(self, verdict: Verdict, name: str) -> None:
        """Take what a method says of it."""
        self.mean[name], self.status[name] = float(verdict.mean or 0.0), verdict.status


Readable = Sequence[FrameResult]
"""Of the frames that could be read."""


def judge_frame(task: FrameTask) -> FrameResult:
    """Judge one frame by each of its methods."""
    cv2.setNumThreads(1)
    try:
        data = task.left if task.camera == LEFT else task.right
        picture = decode_image(data or b"", f"frame {task.number}")
    except FrameError as error:
        return FrameResult(task.number, fault=str(error))
    found = FrameResult(task.number, (picture.shape[0], picture.shape[1]))
    for model in task.thesis:
        judged = model.judge(picture)
        found.add(judged.verdict, model.name)
        found.patches[model.name] = judged.obstacle
    _judge_pair(task, found)
    for method in task.superpixel_methods:
        found.add(verdict_from_mask(method.mask(picture), method.name), method.name)
    if task.spec is not None:
        extractor = build_extractor(task.spec)
        pictures = (picture, *(augment(picture, name) for name in task.changes))
        found.features.extend(extractor.describe(picture, GRID) for picture in pictures)
    return found


def _judge_pair(task: FrameTask, found: FrameResult) -> None:
    """The thesis's disparity, on frames of the size that its numbers are for."""
    if task.left is None or task.right is None or found.size[::-1] != THESIS_FRAME_SIZE:
        return
    try:
        left, right = (decode_image(one, f"frame {task.number}") for one in (task.left, task.right))
    except FrameError:
        return
    if left.shape[1::-1] == right.shape[1::-1] == THESIS_FRAME_SIZE:
        judged = judge_pair(left, right)
        found.mean[THESIS_DISPARITY] = judged.mean
        found.status[THESIS_DISPARITY] = int(judged.obstacle)


def _judge_sequence(
    folder: Path, camera: str, made_by: tuple[str, MakeMethod]
) -> tuple[str, pd.DataFrame]:
    """A method's status, mean and distance of what is nearest, for a mission's frames in order."""
    cv2.setNumThreads(1)
    mission, (name, make) = open_mission(folder), made_by
    method, rows = make(), {}
    for frame in MissionSource(mission, SYSTEM_CLOCK, stereo=RIGHT in mission.cameras):
        if camera == RIGHT and name in ONE_CAMERA:
            frame = replace(frame, left=frame.right, left_fault=frame.right_fault)
        verdict = method.judge(frame).verdict
        rows[frame.number] = verdict.status, verdict.mean, verdict.distance_m
    found = pd.DataFrame.from_dict(rows, orient="index", columns=["status", "mean", "distance_m"])
    return name, found.astype({"mean": float, "distance_m": float})


def _stereo(calibration: StereoCalibration) -> SinglePolicy:
    """Our stereo as ``tokt run`` asks it."""
    return SinglePolicy(DisparityDetector(calibration, GRID))


def _model(file: Path) -> SinglePolicy:
    """A bundle as ``tokt run`` asks it."""
    return SinglePolicy(TextureDetector(read_bundle(file)))


THESIS, COMPARED, OURS = "the thesis's", "compared with", "tokt's"


@dataclass(frozen=True)
class Method:
    """One way of judging frames, whose (`kind`), and in words what it is and what it learnt from.

    A sampled one judged a sample of the frames only.
    """

    title: str
    kind: str
    words: str
    sampled: bool = False


def learnt_words(said: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """What methods learnt from, by title; those that learnt alike in one paragraph."""
    titles: dict[str, list[str]] = {}
    for title, words in said:
        if words:
            titles.setdefault(words, []).append(title)
    return tuple(f"{', '.join(who)}: {words.rstrip('.')}." for words, who in titles.items())


@dataclass
class Curves:
    """Curves of the scored frames in order, index ``frame``, a column a method."""

    mean: pd.DataFrame  # of the 0/255 mask, 0..255, nan where the method did not judge the frame
    status: pd.DataFrame  # 1, 0, or -1 where it did not judge it
    methods: dict[str, Method]
    # Of the texture methods on the grid, by frame: the patches (n_patches,) that are not ocean.
    patches: dict[str, dict[int, Bools]] = field(default_factory=dict)
    # Near end of the matched depths, metres; nan where nothing is measured.
    distance_m: pd.Series = field(default_factory=lambda: pd.Series(dtype=float))
    left_out: list[str] = field(default_factory=list)  # methods that could not be run, and why
    unreadable: tuple[int, ...] = ()  # frames that could not be read

    def add(
        self, name: str, method: Method, mean: Mapping[int, float], status: Mapping[int, int]
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
    settings = presets.settings_named(PRESET) if inputs.obstacle_patches else None
    sample, numbers = inputs.spread(), inputs.scored
    tasks = _frame_tasks(inputs, {n: superpixel_methods.of(n) for n in sample}, settings)
    found = mapped(judge_frame, tasks, inputs.request.jobs)
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
    inputs: StudyInputs, slow: Mapping[int, list[SuperpixelMethod]], settings: Settings
) -> Iterator[FrameTask]:
    """What is to be done with each scored frame; `slow` are the methods of a sample of them."""
    mission = inputs.mission
    lefts, rights = (set(mission.frames(camera)) for camera in (LEFT, RIGHT))
    spec = presets.extractor_for(presets.DEFAULT_EXTRACTOR, PRESET).spec if settings else None
    for number in inputs.scored:
        yield FrameTask(
            number,
            mission.encoded(number, LEFT)[0] if number in lefts else None,
            mission.encoded(number, RIGHT)[0] if number in rights else None,
            list(inputs.thesis.values()),
            slow.get(number, ()),
            spec,
            settings.changes if settings and number in inputs.obstacle_patches else (),
            inputs.request.camera,
        )


def _add_judged(curves: Curves, name: str, method: Method, readable: Readable) -> None:
    """A method that judged the frames one by one."""
    by_it = [one for one in readable if name in one.mean]
    means = {one.number: one.mean[name] for one in by_it}
    curves.add(name, method, means, {one.number: one.status[name] for one in by_it})


def _add_thesis(curves: Curves, inputs: StudyInputs, readable: Readable) -> None:
    """The thesis's texture models, and its disparity."""
    for name, model in inputs.thesis.items():
        _add_judged(curves, name, Method(model.title, THESIS, inputs.two_images), readable)
        curves.patches[name] = {one.number: one.patches[name] for one in readable}
    if any(THESIS_DISPARITY in one.mean for one in readable):
        words = (
            "the thesis's pipeline (not rectified, stretched to 0..255, cropped by 200 px at "
            "either side); it learns nothing"
        )
        _add_judged(curves, THESIS_DISPARITY, Method("disparity", THESIS, words), readable)
    elif not inputs.pairs:
        curves.left_out.append("the thesis's disparity: the mission has no right frames")
    else:
        words = f"the thesis's disparity: its numbers are for frames of {THESIS_SIZE_WORDS}"
        curves.left_out.append(words)


def _add_slow(
    curves: Curves, methods: SuperpixelMethods, sample: Sequence[int], readable: Readable
) -> None:
    """The methods on superpixels."""
    for one in methods.of(sample[0]):
        kind = THESIS if one in methods.textures else COMPARED
        words = (
            f"{one.source}; {methods.words(one).rstrip('.')}. On a sample of {len(sample)} "
            "frames, as it is slow"
        )
        _add_judged(curves, one.name, Method(one.title, kind, words, sampled=True), readable)


def _add_texture(
    curves: Curves, inputs: StudyInputs, settings: Settings, readable: Readable
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
    words = "Mori and Scherer 2013; frames against earlier ones; learns nothing"
    method = Method("growing keypoints", COMPARED, words)
    runs: dict[str, tuple[Method, MakeMethod]] = {SizeChange.name: (method, SizeChange)}
    if calibration is None:
        curves.left_out.append(f"tokt's stereo, and thirds: {cameras}")
    else:
        words = (
            "Kostavelis and others 2009; left, centre and right mean of tokt's rectified "
            f"disparity, with {cameras}; learns nothing"
        )
        method = Method("thirds of disparity", COMPARED, words)
        runs[Thirds.name] = method, partial(Thirds, calibration)
        words = f"rectified disparity as tokt run has it, with {cameras}; learns no frames' looks"
        runs[TOKT_STEREO] = Method("tokt stereo", OURS, words), partial(_stereo, calibration)
    if inputs.request.model is not None:
        runs[TOKT_MODEL] = _model_method(inputs), partial(_model, inputs.request.model)
    judge = partial(_judge_sequence, inputs.mission.path, inputs.request.camera)
    judged = mapped(judge, [(name, make) for name, (_, make) in runs.items()], inputs.request.jobs)
    for name, found in inputs.progress(judged, len(runs), "curves, in order of frames"):
        curves.add(name, runs[name][0], found["mean"], found.status)
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
