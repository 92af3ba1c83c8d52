"""The same model for both sides: a scikit-learn classifier, and the bundle that tokt runs."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from sklearn.svm import LinearSVC

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import Extractor, Glcm, Lbp
from tokt.features.frames.mission import LEFT, Mission
from tokt.features.kernels import reference
from tokt.inference.verdict import Verdict, verdict_from_mask
from tokt.labels.merge import merge_annotators
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.bundle.bundle import Bundle, BundleContent, Golden, bundle_bytes, bundle_from_bytes
from tokt.models.distribution import Distribution, bin_counts, quantile_edges
from tokt.models.linear import LinearModel
from tokt.models.operating_point import OperatingPoint
from tokt.models.sight import measure_sight
from tokt.models.water import WaterPrior
from tokt.training.datasets.mission_source import labels_of_mission, read_labels
from tokt.training.fitting.classifier import fit_classifier, linear_model
from tokt.training.fitting.presets import (
    DEFAULT_EXTRACTOR,
    Hyperparameters,
    extractor_for,
    settings_named,
)
from tokt.training.fitting.train import rendered_other_image
from tokt_studies.baselines.thesis_texture import DESCRIBE, GRID, DescribePatch, resized_gray

LABEL_FILE = "labels.csv"
LABEL_EVERY = 5
"""Every fifth labelled frame is learnt from: the model only has to find obstacle patches."""
_PENALTY = 1.0
_PRIOR = WaterPrior(water=-1.0, obstacle=1.0, water_sd=0.5, obstacle_sd=0.5, share=0.1)
_NEVER_UNLIKE = 1e6  # a distance to landmarks that no patch has

DescribeAll = Callable[[U8], F64]


def all_lbp(gray: U8, points: int, radius: int) -> F64:
    """Normalised histograms of LBP of a gray picture's patches, counted at once."""
    counts = reference.lbp_counts(gray, GRID, points, radius, "patch")
    return np.asarray(counts / counts.sum(axis=1, keepdims=True))


def all_haralick(gray: U8) -> F64:
    """Haralick's 13 features of a gray picture's patches, without grey level 0."""
    return reference.haralick_features(gray, GRID, ignore_zeros=True)


def judge_at_once(frame: U8, describe_all: DescribeAll, classifier: Any) -> Verdict:
    """Judge a frame with the libraries used as well as they can be: one prediction for all patches.

    The thesis asks its classifier patch by patch and counts with `numpy.histogram`; who only wants
    to know what tokt's own code gains over the libraries has to compare with this.
    """
    gray = resized_gray(frame)
    obstacle = classifier.predict(describe_all(gray)) == 1
    return verdict_from_mask(GRID.paint(obstacle, *gray.shape), "libraries")


@dataclass(frozen=True)
class ThesisFeatureSet:
    """One of the thesis's feature sets, both ways."""

    name: str
    extractor: Extractor  # ours: all patches of a frame
    describe_patch: DescribePatch  # the thesis's: one patch
    describe_all: DescribeAll  # the libraries': all patches of a gray picture


_ALL_LBP_10_5 = partial(all_lbp, points=10, radius=5)
_ALL_LBP_24_8 = partial(all_lbp, points=24, radius=8)
FEATURE_SETS = (
    ThesisFeatureSet("lbp_10_5", Lbp(10, 5, "patch"), DESCRIBE["lbp_10_5"], _ALL_LBP_10_5),
    ThesisFeatureSet("lbp_24_8", Lbp(24, 8, "patch"), DESCRIBE["lbp_24_8"], _ALL_LBP_24_8),
    ThesisFeatureSet("haralick", Glcm(ignore_zeros=True), DESCRIBE["haralick"], all_haralick),
)


@dataclass(frozen=True)
class TrainingExamples:
    """Frames and labels that the models learn from."""

    pictures: list[tuple[U8, I64, Bools]]  # a frame, cells (n,) of its grid, which are obstacles
    settings: str  # the preset that says how
    words: str  # the same for people


def examples_from_labels(
    mission: Mission, records: list[LabelRecord], taxonomy: Taxonomy
) -> TrainingExamples:
    """Every fifth labelled frame.

    Raises ToktError if these do not show both obstacles and clear water.
    """
    sure = [
        record
        for record in merge_annotators(records).records
        if record.label not in (UNSURE, None) and record.camera == LEFT
    ]
    chosen = sorted({record.frame for record in sure})[::LABEL_EVERY]
    pictures = []
    for frame in chosen:
        mine = [record for record in sure if record.frame == frame]
        cells = np.array([record.row * GRID.cols + record.col for record in mine], np.int64)
        flags = np.array([taxonomy.is_obstacle(str(record.label)) for record in mine], bool)
        pictures.append((mission.read(frame), cells, flags))
    targets = np.concatenate([flags for _, _, flags in pictures]) if pictures else np.array([])
    if targets.all() or not targets.any():
        raise ToktError(
            f"every {LABEL_EVERY}th labelled frame of {mission.name} is learnt from, and these "
            "do not show both obstacles and clear water"
        )
    words = f"a scaled LinearSVC learnt from {len(chosen)} labelled frames, its scaler folded in"
    return TrainingExamples(pictures, "plain", words)


def examples_from_two_images(mission: Mission) -> TrainingExamples:
    """The thesis's training: the mission's first frame is ocean, a rendered texture is other."""
    cells = np.arange(GRID.n_patches)
    ocean = mission.read(mission.frames()[0])
    pictures = [
        (ocean, cells, np.zeros(GRID.n_patches, bool)),
        (rendered_other_image(), cells, np.ones(GRID.n_patches, bool)),
    ]
    words = "a LinearSVC learnt from two images as in the thesis: the first frame and a texture"
    return TrainingExamples(pictures, "thesis", words)


def learnt_examples(mission: Mission, labels: Path | None = None) -> TrainingExamples:
    """Learn from the label file given, from the one in the mission's folder, or from none."""
    beside = mission.path / LABEL_FILE
    file = labels or (beside if beside.is_file() else None)
    if file is None:
        return examples_from_two_images(mission)
    taxonomy = Taxonomy.load()
    records, _ = labels_of_mission(mission, read_labels([file], taxonomy, GRID), GRID, only=True)
    return examples_from_labels(mission, records, taxonomy)


@dataclass(frozen=True)
class ModelPair:
    """One set of weights for both sides."""

    classifier: Any  # LinearSVC, which the thesis's way asks for each patch; 1 is an obstacle
    bundle: Bundle  # what tokt runs


def fit_preset_bundle(preset: str, examples: TrainingExamples, golden_frame: U8) -> Bundle:
    """Fit a model of a preset that holds all that a run looks at, as `tokt train` gives it.

    Its limits are such that nothing exceeds them: a frame that is refused would cost less.
    """
    settings, extractor = settings_named(preset), extractor_for(DEFAULT_EXTRACTOR, preset)
    rows = np.vstack(
        [extractor.describe(frame, GRID)[cells] for frame, cells, _ in examples.pictures]
    )
    targets = np.concatenate([flags for _, _, flags in examples.pictures]).astype(np.int64)
    choice = Hyperparameters(settings.penalties[0])
    model = linear_model(
        fit_classifier(rows, targets, choice, settings), ("ocean", "other"), (False, True)
    )
    edges = np.stack([quantile_edges(column) for column in rows.T])
    limits = np.ones(extractor.dim)
    point = OperatingPoint(
        water=_PRIOR if settings.moving_boundary else None,
        unlike=None if model.map is None else _NEVER_UNLIKE,
    )
    content = replace(
        _content(preset, extractor, model, golden_frame),
        operating_point=point,
        distribution=Distribution(edges, bin_counts(rows, edges), limits, 1.0, 1, 3, 3),
    )
    return bundle_from_bytes(bundle_bytes(content), f"the bench's model of preset {preset}")


def fit_extractor_pair(
    name: str, extractor: Extractor, examples: TrainingExamples, golden_frame: U8
) -> ModelPair:
    """Fit a classifier and give both sides its weights.

    A scaler is folded in for both, so that the baseline, too, is one predict call a patch and
    nothing more. The golden frame is what the bundle proves itself with; its size is the size the
    bundle accepts.
    """
    settings = settings_named(examples.settings)
    penalty = settings.penalties[0] if settings.two_images else _PENALTY
    rows = [extractor.describe(frame, GRID)[cells] for frame, cells, _ in examples.pictures]
    targets = np.concatenate([flags for _, _, flags in examples.pictures]).astype(np.int64)
    pipeline = fit_classifier(np.vstack(rows), targets, Hyperparameters(penalty), settings)
    model = linear_model(pipeline, ("ocean", "other"), (False, True))
    classifier = LinearSVC(C=penalty, random_state=settings.seed)
    classifier.coef_, classifier.intercept_ = model.weights.copy(), model.bias.copy()
    classifier.classes_, classifier.n_features_in_ = np.array([0, 1]), model.dim
    content = _content(name, extractor, model, golden_frame)
    bundle = bundle_from_bytes(bundle_bytes(content), f"the bench's model {name}")
    return ModelPair(classifier, bundle)


def _content(
    name: str, extractor: Extractor, model: LinearModel, golden_frame: U8
) -> BundleContent:
    values = model.decision_values(extractor.describe(golden_frame, GRID))
    png = cv2.imencode(".png", golden_frame)[1].tobytes()
    return BundleContent(
        name=f"bench-{name.replace('_', '-')}",
        version="1",
        extractor_spec=extractor.spec,
        grid=GRID,
        model=model,
        provenance={"made_by": "tokt bench"},
        metrics={},
        golden=Golden((png,), values[None], model.obstacle_patches(values)[None]),
        trained_on=np.zeros(0, np.uint64),
        card="Made by tokt bench to measure speed; not to be deployed.\n",
        sight=measure_sight([golden_frame]),
    )
