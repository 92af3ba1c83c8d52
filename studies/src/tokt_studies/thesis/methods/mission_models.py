"""Models trained for a mission: tokt's texture, held out or of all labels, and superpixels'.

A frame of the mission is judged by a model that never saw it (`held_out_texture`): models learn
from labelled blocks of frames and judge the others (`tokt.training.datasets.folds`). A frame that
is labelled is judged by the model of the fold that tests it; one without labels by the model whose
training frames are farthest from it, if they are beyond the embargo.

A picture of somewhere else may be judged by a model that learnt from labelled frames all over the
mission (`learnt_from_labels`), and so may what is only timed (`tokt_model`).
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import Mission
from tokt.inference.texture.detector import MofNRun, min_mask_patches
from tokt.inference.verdict import UNKNOWN, verdict_from_mask
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.operating_point import MofNRule, frame_step, missed_before
from tokt.training.datasets.changed_patches import ChangedPatches
from tokt.training.datasets.dataset import DatasetVersion, write_dataset
from tokt.training.datasets.dive_positions import dive_positions
from tokt.training.datasets.folds import (
    BLOCK_FRAMES,
    EMBARGO_FRAMES,
    FOLDS,
    Fold,
    blocked_folds,
    embargo_of,
)
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions
from tokt.training.datasets.split import Split
from tokt.training.fitting import presets
from tokt.training.fitting.choose_operating_point import DEFAULT_TARGET, choose_frame_rule
from tokt.training.fitting.classifier import decision_values, fit_rows, linear_model
from tokt.training.fitting.cross_validation import (
    check_features,
    choose_hyperparameters,
    rows_tested,
)
from tokt.training.rig.calibrate.frame_selection import evenly_spaced
from tokt_studies.baselines.lab_colour import LabColour, labelled_example
from tokt_studies.baselines.slic import SlicTexture
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.speed.models import TrainingExamples, examples_from_two_images, fit_extractor_pair
from tokt_studies.thesis.inputs import StudyInputs

TOKT_TEXTURE = "tokt_texture"
PRESET = "best"
SLIC = ("lbp_10_5", "haralick")
EXAMPLES = 12
"""Labelled frames, of either half of the blocks, that superpixels' colours are learnt from."""
_MIN_BLOCKS = 10
_WEAK_BLOCK_FRAMES = 5
_MAX_FRAMES = 60
"""Learnt from by `learnt_from_labels`, spread over the labelled ones: neighbours in time are near
copies."""

SuperpixelMethod = SlicTexture | LabColour
Tables = Mapping[int, Sequence[F64]]
Sizes = Mapping[int, tuple[int, int]]
Learnt = tuple[list[MofNRule], dict[int, tuple[int, F64]]]
"""By fold its frame rule, chosen inside the training part; by frame its fold and its scores."""


class HeldOutTexture(NamedTuple):
    """Results of held-out models by frame, and how they were split.

    Patches are those whose decision value is over the threshold, whatever the frame rule says.
    """

    mean: dict[int, float]
    status: dict[int, int]
    patches: dict[int, Bools]
    words: str


def held_out_texture(
    inputs: StudyInputs, features: Tables, sizes: Sizes, settings: presets.TrainingSettings
) -> HeldOutTexture:
    """Judge each frame that could be read, of `sizes` (height, width), by a model of other blocks.

    Features are of the frame as it is, then as each change of the settings makes it. Raises
    ToktError if the labels are too few, or all of one class, for blocks to be held out.
    """
    with tempfile.TemporaryDirectory(prefix="tokt-reproduce-") as name:
        dataset, split = _dataset(inputs, Path(name), list(sizes))
        split.check(dataset.patches, dataset.targets())
        learnt = _learn(inputs, dataset, split, features, settings)
    return _judged(learnt, sizes, _words(dataset, split, settings))


def _dataset(
    inputs: StudyInputs, folder: Path, readable: Sequence[int]
) -> tuple[DatasetVersion, Split]:
    """The labelled frames that could be read, cut into blocks."""
    labelled = sorted(set(inputs.obstacle_patches) & set(readable))
    block = min(BLOCK_FRAMES, max(2, len(labelled) // _MIN_BLOCKS))
    mine = [LabelledMission(inputs.mission, inputs.labels or [])]
    plan, _ = plan_from_missions(
        "reproduce", "binary", mine, inputs.taxonomy, GRID, labelled, block
    )
    dataset = write_dataset(plan, folder, inputs.progress)
    return dataset, Split(FOLDS, embargo_of(block))


def _tables(dataset: DatasetVersion, features: Tables, count: int) -> list[F64]:
    """Features of the dataset's patches: of frames as they are, then as each change makes them."""
    patches = dataset.patches
    cells = (patches.row * dataset.grid.cols + patches.col).to_numpy()
    dim = next(iter(features.values()))[0].shape[1]
    tables = [np.empty((len(patches), dim)) for _ in range(count)]
    for key, rows in patches.groupby("frame").indices.items():
        for table, described in zip(tables, features[int(str(key))], strict=True):
            table[rows] = described[cells[rows]]
    return tables


def _learn(
    inputs: StudyInputs,
    dataset: DatasetVersion,
    split: Split,
    features: Tables,
    settings: presets.TrainingSettings,
) -> Learnt:
    """Judge frames by models of the folds' training parts."""
    table, *others = _tables(dataset, features, 1 + len(settings.changes))
    augmented = [ChangedPatches(other, np.arange(len(other))) for other in others]
    check_features(dataset, table)
    patches, targets = dataset.patches, dataset.targets()
    folds = blocked_folds(patches, targets, split.folds, split.embargo_frames)
    judges = _judges(dataset, folds, list(features), inputs.mission, split.embargo_frames)
    rules: list[MofNRule] = []
    said: dict[int, tuple[int, F64]] = {}
    for index, fold in enumerate(inputs.progress(folds, len(folds), "our texture, held out")):
        learnt = patches, table, targets, settings, split.inner, augmented, inputs.request.jobs
        chosen = choose_hyperparameters(*learnt, rows=fold.train)
        pipeline = fit_rows(table, targets, fold.train, chosen.choice, settings, augmented)
        model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
        scores, tested = model.obstacle_score(chosen.values), rows_tested(chosen.values)
        rule, _ = choose_frame_rule(dataset, scores, tested, DEFAULT_TARGET)
        rules.append(rule)
        for number in (number for number, judge in judges.items() if judge == index):
            values = decision_values(pipeline, features[number][0])
            said[number] = index, model.obstacle_score(values)
    return rules, said


def _judges(
    dataset: DatasetVersion,
    folds: Sequence[Fold],
    frames: Sequence[int],
    mission: Mission,
    embargo_frames: int,
) -> dict[int, int]:
    """Which fold's model judges a frame; a frame that none may judge is left out."""
    frame, position = (dataset.patches[name].to_numpy() for name in ("frame", "position"))
    at = dive_positions(mission).of_frame
    judges = {
        int(number): index
        for index, fold in enumerate(folds)
        for number in np.unique(frame[fold.test])
    }
    for number in frames:
        if number not in judges:
            away = [int(np.abs(position[fold.train] - at[number]).min()) for fold in folds]
            if max(away) > embargo_frames:
                judges[number] = int(np.argmax(away))
    return judges


def _judged(learnt: Learnt, sizes: Sizes, words: str) -> HeldOutTexture:
    """The frames in their order by each fold's rule; a frame's verdict is that of its own fold."""
    rules, scores = learnt
    numbers = sorted(sizes)
    missed = missed_before(numbers, frame_step(numbers))
    found = HeldOutTexture({}, {}, {}, words)
    for index, rule in enumerate(rules):
        run = MofNRun(rule)
        for number, gap in zip(numbers, missed, strict=True):
            run.begin(gap)
            if number not in scores:
                continue
            own_fold, values = scores[number]
            size = GRID.resized(*sizes[number])
            ruled = run.result(values, values > 0, min_mask_patches(GRID, *size))
            if own_fold != index:
                continue
            found.patches[number] = values > 0
            found.mean[number], found.status[number] = float("nan"), UNKNOWN
            if ruled.patches is not None:
                verdict = verdict_from_mask(GRID.paint(ruled.patches, *size), TOKT_TEXTURE)
                found.mean[number] = float(verdict.mean or 0.0)
                found.status[number] = verdict.status
    return found


def _words(dataset: DatasetVersion, split: Split, settings: presets.TrainingSettings) -> str:
    weak = (
        "weak split, as short blocks leave near copies on both sides: "
        if (dataset.block_frames or 0) < _WEAK_BLOCK_FRAMES
        else ""
    )
    own_choice = f" {presets.CHOSEN_ON['best']}" if settings.preset == "best" else ""
    return (
        f"preset {settings.preset}; {weak}{split.folds}-fold cross-validation over blocks of "
        f"{dataset.block_frames} frames, without training frames within {split.embargo_frames} of "
        "a tested one. C and the frame rule are chosen inside each training part. A frame without "
        "labels is judged by the fold whose training frames are farthest from it."
        f"{own_choice}"
    )


def learnt_from_labels(inputs: StudyInputs, near: int | None = None) -> tuple[Bundle, str]:
    """A texture model of the mission's labelled frames, and what it learnt from.

    From the frame `near` these stay away by more than the embargo; no other frame is held out.
    Raises ToktError if the labels do not show both obstacles and clear water.
    """
    numbers = [
        number
        for number in inputs.obstacle_patches
        if near is None or abs(number - near) > EMBARGO_FRAMES
    ]
    pictures = []
    for number, frame in inputs.decoded(evenly_spaced(numbers, _MAX_FRAMES)):
        truth = inputs.truth(number)
        cells = np.flatnonzero(truth >= 0)
        pictures.append((frame, cells, truth[cells] == 1))
    if len(np.unique([one for _, _, flags in pictures for one in flags])) < 2:
        raise ToktError("there are no labels of both obstacles and clear water to learn from")
    left_out = f", none within {EMBARGO_FRAMES} of frame {near}" if near is not None else ""
    words = f"learnt from {len(pictures)} labelled frames spread over the mission{left_out}"
    return _fitted(inputs, TrainingExamples(pictures, PRESET, words))


def tokt_model(inputs: StudyInputs) -> tuple[Bundle, str]:
    """The bundle of the request, or a texture model that learnt from all it may, and from what.

    Without labels it learns from the thesis's kind of images, an early frame and a texture.
    """
    if inputs.request.model is not None:
        bundle = read_bundle(str(inputs.request.model))
        return bundle, f"the model {bundle.label} as given"
    try:
        return learnt_from_labels(inputs)
    except ToktError as error:
        inputs.say(f"no model from the labels: {error}")
        return _fitted(inputs, examples_from_two_images(inputs.mission))


def _fitted(inputs: StudyInputs, examples: TrainingExamples) -> tuple[Bundle, str]:
    extractor = presets.extractor_for(presets.DEFAULT_EXTRACTOR, PRESET)
    models = fit_extractor_pair(PRESET, extractor, examples, inputs.any_picture())
    return models.bundle, f"the features of preset {PRESET}, {examples.words}"


@dataclass(frozen=True)
class SuperpixelMethods:
    """SLIC with the thesis's textures, and superpixels by their colour, and what they learnt from.

    Of two models of colours the first judges even blocks of frames and learnt from odd ones, the
    second the other way round.
    """

    textures: tuple[SlicTexture, ...]
    colours: tuple[LabColour, ...]
    block_frames: int
    texture_words: str
    colour_words: str

    def of(self, number: int) -> list[SuperpixelMethod]:
        """The methods that may judge a frame of the mission: none learnt from its block."""
        block = number // self.block_frames
        return [*self.textures, self.colours[block % len(self.colours)]]

    def words(self, method: SuperpixelMethod) -> str:
        """What a method learnt from."""
        return self.texture_words if method in self.textures else self.colour_words


def train_superpixel_methods(inputs: StudyInputs) -> SuperpixelMethods:
    """Train them: SLIC on the thesis's two images, the colours on labels where there are some."""
    ocean, other = inputs.ocean.image, inputs.other.image
    textures = tuple(
        SlicTexture.train(ocean, other, inputs.thesis[name].describe, name) for name in SLIC
    )
    two = inputs.two_images
    block = min(BLOCK_FRAMES, max(2, len(inputs.obstacle_patches) // 10))
    try:
        halves = [_examples(inputs, block, parity) for parity in (1, 0)]
        colours = tuple(
            LabColour.train(
                labelled_example(frame, inputs.truth(number))
                for number, frame in inputs.decoded(half)
            )
            for half in halves
        )
    except ToktError as error:
        why = f"; not from labels: {error}" if inputs.labels else ""
        return SuperpixelMethods(
            textures, (LabColour.train_on_two(ocean, other),), block, two, two + why
        )
    words = (
        f"held out by blocks of {block} frames. Even blocks are judged by the labels of "
        f"{len(halves[0])} frames of odd ones, odd blocks by those of {len(halves[1])} of even ones"
    )
    return SuperpixelMethods(textures, colours, block, two, words)


def _examples(inputs: StudyInputs, block: int, parity: int) -> list[int]:
    """Labelled frames of every second block, away from the blocks in between, evenly spread."""
    embargo = embargo_of(block)
    found = [
        number
        for number in inputs.obstacle_patches
        if number // block % 2 == parity
        and embargo <= number % block < block - embargo
        and number in inputs.scored
    ]
    seen = [number for number in found if inputs.obstacle_patches[number]]
    clear = [number for number in found if not inputs.obstacle_patches[number]]
    if not seen or not clear:
        raise ToktError("a half of the blocks does not show both obstacles and clear water")
    count = EXAMPLES // 2
    return sorted(n for part in (seen, clear) for n in part[:: max(1, -(-len(part) // count))])
