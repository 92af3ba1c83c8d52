"""Mean value and status of every frame by every method: what figures 5.3 to 5.5 are drawn from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import pixel_sha256
from tokt.features.frames.mission import LEFT, RIGHT
from tokt.inference.verdict import UNKNOWN
from tokt.models.bundle.bundle import frame_id, read_bundle
from tokt.studies.baselines.baseline import Baseline
from tokt.studies.baselines.slic import SlicTexture
from tokt.studies.baselines.thesis_models import TITLES
from tokt.studies.baselines.thesis_stereo import THESIS_FRAME_SIZE
from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.fitting.presets import (
    DEFAULT_EXTRACTOR,
    TrainingSettings,
    extractor_for,
    settings_named,
)

from .frame_methods import (
    MEAN_DISPARITY,
    SIZE_CHANGE,
    THESIS_DISPARITY,
    TOKT_MODEL,
    TOKT_STEREO,
    FrameResult,
    FrameTask,
    JudgeNext,
    bundle_judge,
    judge_frames,
    judge_sequences,
    size_change_judge,
    stereo_judge,
    thirds_judge,
)
from .mission_models import PRESET, SLIC, TOKT_TEXTURE, SuperpixelMethods, held_out_texture

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


@dataclass(frozen=True)
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
    left_out : tuple of str
        Which methods could not be run, and why.
    unreadable : tuple of int
        Frames that could not be read.
    """

    mean: pd.DataFrame
    status: pd.DataFrame
    methods: dict[str, Method]
    patches: dict[str, dict[int, NDArray[np.bool_]]] = field(default_factory=dict)
    distance_m: pd.Series = field(default_factory=lambda: pd.Series(dtype=float))
    left_out: tuple[str, ...] = ()
    unreadable: tuple[int, ...] = ()

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
    gathered = _Gathered(inputs, [one for one in judged if not one.fault])
    gathered.add_thesis()
    gathered.add_slow(superpixel_methods, sample)
    gathered.add_texture(settings)
    distance_m = gathered.add_runs()
    return Curves(
        gathered.mean,
        gathered.status,
        gathered.methods,
        gathered.patches,
        distance_m.reindex(gathered.mean.index),
        tuple(gathered.left_out),
        tuple(one.number for one in judged if one.fault),
    )


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


class _Gathered:
    """Curves while they are put together of the frames that could be read."""

    def __init__(self, inputs: StudyInputs, readable: Sequence[FrameResult]) -> None:
        index = pd.Index([one.number for one in readable], name="frame")
        self._inputs, self._readable = inputs, readable
        self.mean, self.status = pd.DataFrame(index=index), pd.DataFrame(index=index)
        self.methods: dict[str, Method] = {}
        self.patches: dict[str, dict[int, NDArray[np.bool_]]] = {}
        self.left_out: list[str] = []

    def _add(
        self,
        name: str,
        method: Method,
        mean: pd.Series | dict[int, float],
        status: pd.Series | dict[int, int],
    ) -> None:
        """A method's means and statuses by frame; of frames that are not there it knows none."""
        self.mean[name] = pd.Series(mean, dtype=float).reindex(self.mean.index)
        said = pd.Series(status, dtype="Int64").reindex(self.status.index)
        self.status[name] = said.fillna(UNKNOWN).astype(int)
        self.methods[name] = method

    def _add_judged(self, name: str, method: Method) -> None:
        """A method that judged the frames one by one."""
        by_it = [one for one in self._readable if name in one.mean]
        means = {one.number: one.mean[name] for one in by_it}
        self._add(name, method, means, {one.number: one.status[name] for one in by_it})

    def add_thesis(self) -> None:
        """The thesis's texture models, and its disparity."""
        for name, model in self._inputs.thesis.items():
            words = f"{model.title} as the thesis has it, {self._inputs.two_images}"
            self._add_judged(name, Method(model.title, THESIS, words))
            self.patches[name] = {one.number: one.patches[name] for one in self._readable}
        if any(THESIS_DISPARITY in one.mean for one in self._readable):
            words = (
                "the thesis's disparity pipeline (not rectified, stretched to 0..255, cropped by "
                "200 px at either side); it learns nothing"
            )
            self._add_judged(THESIS_DISPARITY, Method("disparity", THESIS, words))
        elif not self._inputs.pairs:
            self.left_out.append("the thesis's disparity: the mission has no right frames")
        else:
            size = "x".join(map(str, THESIS_FRAME_SIZE))
            self.left_out.append(f"the thesis's disparity: its numbers are for frames of {size}")

    def add_slow(self, methods: SuperpixelMethods, sample: Sequence[int]) -> None:
        """The methods on superpixels."""
        for one in methods.of(sample[0]):
            kind = THESIS if isinstance(one, SlicTexture) else COMPARED
            words = (
                f"{one.title} ({one.source}), {methods.words(one)}; on a sample of {len(sample)} "
                "frames, as it is slow"
            )
            title = SLIC_TITLES.get(one.name, one.title)
            self._add_judged(one.name, Method(title, kind, words, sampled=True))

    def add_texture(self, settings: TrainingSettings | None) -> None:
        """Our texture model, held out; without settings there is nothing to learn from."""
        try:
            if settings is None:
                raise ToktError("there are no labels to learn from")
            found = held_out_texture(self._inputs, self._readable, settings)
        except ToktError as error:
            self.left_out.append(f"tokt's texture model: {error}")
            return
        method = Method("tokt texture, held out", OURS, found.words)
        self._add(TOKT_TEXTURE, method, found.mean, found.status)
        self.patches[TOKT_TEXTURE] = found.patches

    def add_runs(self) -> pd.Series:
        """The methods that look at frames in their order; the distances that stereo measures."""
        inputs, calibration = self._inputs, self._inputs.calibration
        # The one that takes longest first, so that the others run beside it.
        words = (
            "growing keypoints (Mori and Scherer 2013): frames against earlier ones; learns nothing"
        )
        methods = {SIZE_CHANGE: Method("growing keypoints", COMPARED, words)}
        makers: dict[str, Callable[[], JudgeNext]] = {SIZE_CHANGE: size_change_judge}
        if calibration is None:
            self.left_out.append(f"tokt's stereo, and thirds: {inputs.calibration_words}")
        else:
            methods |= _stereo_methods(inputs.calibration_words)
            makers[MEAN_DISPARITY] = partial(thirds_judge, calibration)
            makers[TOKT_STEREO] = partial(stereo_judge, calibration)
        if inputs.request.model is not None:
            methods[TOKT_MODEL] = _model_method(inputs)
            makers[TOKT_MODEL] = partial(bundle_judge, inputs.request.model)
        runs = judge_sequences(makers, inputs.mission.path, inputs.request.jobs)
        distance_m = pd.Series(dtype=float)
        for name, found in inputs.progress(runs, len(makers), "curves, in order of frames"):
            self._add(name, methods[name], found["mean"], found.status)
            if name == TOKT_STEREO:
                distance_m = found.distance_m
        return distance_m


def _stereo_methods(cameras: str) -> dict[str, Method]:
    """By column; `cameras` says where the calibration is from."""
    thirds = (
        "left, centre and right mean disparity (Kostavelis and others 2009) on tokt's rectified "
        f"disparity, with {cameras}; learns nothing"
    )
    ours = f"tokt's rectified disparity as tokt run has it, with {cameras}; learns no frames' looks"
    return {
        MEAN_DISPARITY: Method("thirds of disparity", COMPARED, thirds),
        TOKT_STEREO: Method("tokt stereo", OURS, ours),
    }


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
