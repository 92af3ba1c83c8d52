"""Mean value and status of every frame by every method: what figures 5.3 to 5.5 are drawn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import pixel_sha256
from tokt.inference.verdict import UNKNOWN
from tokt.models.bundle.bundle import frame_id, read_bundle
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

from .held_out_texture import TOKT_TEXTURE, held_out_texture
from .per_frame_methods import THESIS_DISPARITY, Extraction, FrameMethods, FrameResult, judge_frames
from .sequence_methods import (
    MEAN_DISPARITY,
    SIZE_CHANGE,
    TOKT_MODEL,
    TOKT_STEREO,
    SequenceTask,
    judge_sequences,
)
from .superpixel_methods import SLIC, SuperpixelMethods

THESIS, COMPARED, OURS = "the thesis's", "compared with", "tokt's"
PRESET = "best"
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

    @property
    def words(self) -> dict[str, str]:
        """By method: what it is, and what it learnt from."""
        return {name: method.words for name, method in self.methods.items()}

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


class _Gathered:
    """Curves while they are put together."""

    def __init__(self, numbers: Sequence[int]) -> None:
        index = pd.Index(numbers, name="frame")
        self.mean, self.status = pd.DataFrame(index=index), pd.DataFrame(index=index)
        self.methods: dict[str, Method] = {}
        self.left_out: list[str] = []

    def add(
        self, name: str, method: Method, mean: dict[int, float], status: dict[int, int]
    ) -> None:
        """A method's means and statuses by frame; of frames that are not there it knows none."""
        self.mean[name] = pd.Series(mean, dtype=float).reindex(self.mean.index)
        said = pd.Series(status, dtype="Int64").reindex(self.status.index)
        self.status[name] = said.fillna(UNKNOWN).astype(int)
        self.methods[name] = method


def measure_curves(inputs: StudyInputs, superpixel_methods: SuperpixelMethods) -> Curves:
    """Judge every scored frame by every method.

    What was learnt from one frame is not scored on it: the thesis's models and the compared ones
    learn from two images, and a mission's frame among these is not scored; ours is held out
    (`held_out_texture`). SLIC and superpixel colours judge a sample of the frames.
    """
    settings = settings_named(PRESET) if inputs.obstacle_patches else None
    sample = inputs.spread()
    judged = _judge_frames(inputs, superpixel_methods, sample, settings)
    readable = [one for one in judged if not one.fault]
    gathered = _Gathered([one.number for one in readable])
    _add_thesis(gathered, inputs, readable)
    _add_slow(gathered, superpixel_methods, readable, sample)
    patches = {name: {one.number: one.patches[name] for one in readable} for name in inputs.thesis}
    if settings is None:
        gathered.left_out.append("tokt's texture model: there are no labels to learn from")
    else:
        patches |= _add_texture(gathered, inputs, readable, settings)
    distance = _add_runs(gathered, inputs)
    return Curves(
        gathered.mean,
        gathered.status,
        gathered.methods,
        patches,
        pd.Series(distance, dtype=float).reindex(gathered.mean.index),
        tuple(gathered.left_out),
        tuple(one.number for one in judged if one.fault),
    )


def _judge_frames(
    inputs: StudyInputs,
    superpixel_methods: SuperpixelMethods,
    sample: Sequence[int],
    settings: TrainingSettings | None,
) -> list[FrameResult]:
    extraction = None
    if settings is not None:
        extraction = Extraction(extractor_for(DEFAULT_EXTRACTOR, PRESET).spec, settings.changes)
    judges = FrameMethods(
        list(inputs.thesis.values()),
        {number: superpixel_methods.of(number) for number in sample},
        extraction,
        frozenset(inputs.obstacle_patches),
    )
    numbers = inputs.scored
    found = judge_frames(inputs.mission, numbers, judges, inputs.request.jobs)
    return list(inputs.progress(found, len(numbers), "curves, frame by frame"))


def _add_thesis(gathered: _Gathered, inputs: StudyInputs, readable: Sequence[FrameResult]) -> None:
    learnt = inputs.two_images
    for name, model in inputs.thesis.items():
        title, words = f"{model.title}", f"{model.title} as the thesis has it, {learnt}"
        _add(gathered, name, Method(title, THESIS, words), readable)
    if any(THESIS_DISPARITY in one.mean for one in readable):
        words = (
            "the thesis's disparity pipeline (not rectified, stretched to 0..255, cropped by 200 "
            "px at either side); it learns nothing"
        )
        _add(gathered, THESIS_DISPARITY, Method("disparity", THESIS, words), readable)
    elif not inputs.pairs:
        gathered.left_out.append("the thesis's disparity: the mission has no right frames")
    else:
        size = "x".join(map(str, THESIS_FRAME_SIZE))
        gathered.left_out.append(f"the thesis's disparity: its numbers are for frames of {size}")


def _add(gathered: _Gathered, name: str, method: Method, readable: Sequence[FrameResult]) -> None:
    mean = {one.number: one.mean[name] for one in readable if name in one.mean}
    status = {one.number: one.status[name] for one in readable if name in one.status}
    gathered.add(name, method, mean, status)


def _add_slow(
    gathered: _Gathered,
    superpixel_methods: SuperpixelMethods,
    readable: Sequence[FrameResult],
    sample: Sequence[int],
) -> None:
    for one in superpixel_methods.of(sample[0]):
        kind = THESIS if isinstance(one, SlicTexture) else COMPARED
        words = (
            f"{one.title} ({one.source}), {superpixel_methods.words(one)}; on a sample of "
            f"{len(sample)} frames, as it is slow"
        )
        title = SLIC_TITLES.get(one.name, one.title)
        _add(gathered, one.name, Method(title, kind, words, sampled=True), readable)


def _add_texture(
    gathered: _Gathered,
    inputs: StudyInputs,
    readable: Sequence[FrameResult],
    settings: TrainingSettings,
) -> dict[str, dict[int, NDArray[np.bool_]]]:
    try:
        found = held_out_texture(inputs, readable, settings)
    except ToktError as error:
        gathered.left_out.append(f"tokt's texture model: {error}")
        return {}
    method = Method("tokt texture, held out", OURS, found.words)
    gathered.add(TOKT_TEXTURE, method, found.mean, found.status)
    return {TOKT_TEXTURE: found.patches}


def _add_runs(gathered: _Gathered, inputs: StudyInputs) -> dict[int, float]:
    """The methods that look at frames in their order; the distances that stereo measures."""
    request, calibration = inputs.request, inputs.calibration
    names = {SIZE_CHANGE: _size_change(), **_stereo_methods(inputs)}
    if calibration is None:
        gathered.left_out.append(f"tokt's stereo, and thirds: {inputs.calibration_words}")
    if request.model is not None:
        names[TOKT_MODEL] = _model_method(inputs)
    # The one that takes longest first, so that the others run beside it.
    tasks = [SequenceTask(name, inputs.mission.path, calibration, request.model) for name in names]
    runs = judge_sequences(tasks, request.jobs)
    found = {
        one.method: one for one in inputs.progress(runs, len(tasks), "curves, in order of frames")
    }
    for name, method in names.items():
        gathered.add(name, method, found[name].mean, found[name].status)
    return found[TOKT_STEREO].distance_m if TOKT_STEREO in found else {}


def _size_change() -> Method:
    words = "growing keypoints (Mori and Scherer 2013): frames against earlier ones; learns nothing"
    return Method("growing keypoints", COMPARED, words)


def _stereo_methods(inputs: StudyInputs) -> dict[str, Method]:
    if inputs.calibration is None:
        return {}
    cameras = inputs.calibration_words
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


def without_sampled(curves: Curves) -> Curves:
    """The same without the methods that judged a sample of the frames only."""
    names = [name for name, method in curves.methods.items() if not method.sampled]
    methods = {name: curves.methods[name] for name in names}
    return replace(curves, mean=curves.mean[names], status=curves.status[names], methods=methods)
