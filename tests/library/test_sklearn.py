"""tokt's estimators as scikit-learn uses them, on small dives in colour."""

import doctest
import pickle
from dataclasses import replace

import cv2
import joblib
import numpy as np
import pandas as pd
import pytest
from sklearn import config_context
from sklearn.base import clone
from sklearn.exceptions import SkipTestWarning
from sklearn.metrics import f1_score
from sklearn.model_selection import GridSearchCV, cross_val_predict
from sklearn.pipeline import Pipeline, make_pipeline, make_union
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC
from sklearn.utils.estimator_checks import check_estimator
from sklearn.utils.validation import validate_data

import tokt.sklearn
from tests.calls import refuses, succeeds
from tests.fixtures import draw_tiny_frame, tiny_labels, write_labels
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import extractor_named, gray_picture
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission, parse_frames
from tokt.sklearn import (
    LBP,
    DiveSplit,
    Haralick,
    Patches,
    PatchFeatures,
    WaterFeatures,
    load_dataset,
    patches_of,
)
from tokt.training.datasets.dataset import open_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.split import Split
from tokt.training.fitting.presets import settings_named
from tokt.training.fitting.train import TrainRequest, fit_and_measure

EXTRACTORS = {
    "lbp": LBP(),
    "lbp_24_8_frame": LBP(points=24, radius=8, border="frame"),
    "haralick_log": Haralick(log=True),
    "water": WaterFeatures(),
    "haralick+lbp_24_8": PatchFeatures("haralick+lbp_24_8"),
    "lbp_flat_8_5": PatchFeatures(extractor_named("lbp_flat_8_5").spec),
}
MIN_CHECKS = 45
FRAMES = 28


def write_dive(folder, seed):
    """Write the frames of the tiny mission in colour, with noise of a dive's own."""
    rng = np.random.default_rng(seed)
    (folder / "Left").mkdir(parents=True)
    for frame in range(1, FRAMES + 1):
        colour = draw_tiny_frame(frame)[..., None] * (1.2, 1.0, 0.6)  # blue, green, red of water
        noisy = (colour + rng.normal(0, 1, colour.shape)).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / "Left" / f"{folder.name}_L_{frame}.png"), noisy)
    rows = [row for row in tiny_labels(folder.name) if row[2] <= FRAMES]
    write_labels(folder / "labels.csv", rows)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    """Datasets `one`, a dive that is split by blocks, and `two`, of two dives."""
    home = tmp_path_factory.mktemp("sklearn")
    for seed, name in ((1, "east"), (2, "west")):
        write_dive(home / name, seed)
    where = ("--workspace", home / ".tokt", "--block", 4)
    given = [("--mission", home / d, "--labels", home / d / "labels.csv") for d in ("east", "west")]
    succeeds("dataset", "build", "one", *given[0], *where)
    succeeds("dataset", "build", "two", *given[0], *given[1], *where)
    return home / ".tokt"


@pytest.fixture(scope="module")
def one(workspace):
    return load_dataset("one", workspace)


@pytest.fixture(scope="module")
def frames(workspace):
    mission = open_mission(workspace.parent / "east")
    return [mission.read(number) for number in (1, 14, 20)]


def same_bits(found, expected):
    return found.dtype == expected.dtype and found.tobytes() == expected.tobytes()


@pytest.mark.parametrize("name", EXTRACTORS)
@pytest.mark.parametrize("grid", ["10x10@360", "4x7@200"])
def test_rows_are_those_of_describe_bit_for_bit(name, grid, frames):
    extractor, X = extractor_named(name), patches_of(frames, grid)
    rows = np.vstack([extractor.describe(frame, Grid.parse(grid)) for frame in frames])
    assert same_bits(EXTRACTORS[name].fit_transform(X), rows)
    assert EXTRACTORS[name].extractor().spec == extractor.spec
    assert EXTRACTORS[name].get_feature_names_out().tolist() == list(extractor.names)
    order = np.random.default_rng(0).permutation(len(X))[:50].repeat(2)
    assert same_bits(EXTRACTORS[name].transform(X[order]), rows[order])


def test_a_ready_cut_patch_has_the_same_row_where_only_the_patch_is_looked_at(frames):
    cut = gray_picture(frames[1], Grid())
    cut, X = Grid().cells(cut), patches_of(frames[1:2])
    for alone in (LBP(), LBP(24, 8), Haralick(), Haralick(log=True, ignore_zeros=True)):
        assert same_bits(alone.transform(cut), alone.transform(X))
        assert same_bits(alone.transform(list(cut)), alone.transform(X))
    for wider in (LBP(border="frame"), WaterFeatures(colour=False), PatchFeatures("lbp_flat_8_5")):
        assert not np.array_equal(wider.transform(cut), wider.transform(X))


@pytest.mark.parametrize(
    ("X", "words"),
    [
        (np.zeros((5, 972), np.uint8), r"ndarray \(5, 972\).*Patches, or images.*X.reshape"),
        (None, "X is NoneType"),
        (np.zeros((5, 27, 36)), "images of uint8, gray or BGR: .*float64"),
        ([np.zeros((27, 36, 2), np.uint8)], r"not \(27, 36, 2\)"),
        ([], "0 sample"),
    ],
)
def test_what_is_no_patches_is_refused_in_one_line(X, words):
    refuses(words, LBP().transform, X)


def test_refusals_are_what_scikit_learn_expects_too(one):
    for call in (lambda: LBP().fit([]), lambda: LinearSVC().fit(one.data, one.target)):
        with pytest.raises(ValueError, match=r"patches|sample") as caught:
            call()
        assert isinstance(caught.value, ToktError)
    refuses("a pipeline starts with LBP", np.asarray, one.data)
    refuses("4-64", LBP(points=2).fit, one.data)
    refuses("unknown extractor 'lbq'", PatchFeatures("lbq").fit, one.data)
    refuses("unknown extractor 'None'", PatchFeatures(None).fit, one.data)
    refuses("at most 1.0, not 'a'", WaterFeatures(quietest="a").fit, one.data)
    assert len(WaterFeatures(quietest=np.float32(1)).fit(one.data).transform(one.data[:1])) == 1
    refuses("one colour frame", patches_of, np.zeros((271, 360, 3), np.uint8))
    refuses("not a grid", patches_of, [], "ten")


def test_samples_are_indexed_like_an_array(one):
    X = one.data
    assert (len(X), X.shape) == (len(one.target), (len(one.target),))
    first, mask = X[0], np.arange(len(X)) % 7 == 3
    assert isinstance(first, Patches) and len(first) == 1 and len(X[-5:]) == 5
    for rows in (mask, np.flatnonzero(mask), (np.flatnonzero(mask), ...), slice(3, None, 7)):
        part = X[rows]
        assert part.frame.tolist() == X.frame[mask].tolist()
        assert part.groups.equals(X.groups[mask])
    assert len(X[[]]) == len(X[:0]) == 0 and X[[-1, 0]].frame.tolist() == [X.frame[-1], X.frame[0]]
    for wrong in (len(X), (1, 2), None, np.array([[1, 2]]), np.array([True]), 1.5):
        with pytest.raises(IndexError):
            X[wrong]


def test_a_dataset_is_that_of_tokt(one, workspace, tmp_path):
    dataset = open_dataset("one", workspace / "datasets")
    assert one.label == dataset.label and one.target_names.tolist() == list(dataset.classes())
    assert one.target.tolist() == dataset.targets().tolist()
    spec = extractor_named("lbp_10_5_frame").spec
    features = cached_features(dataset, spec, tmp_path, lambda items, *_: items, 1)
    assert same_bits(LBP(border="frame").transform(one.data), np.array(features))
    X, y = load_dataset(dataset, return_X_y=True)
    assert len(X) == len(y) == len(one.target)
    refuses("no dataset 'three'", load_dataset, "three", workspace)


@pytest.mark.parametrize("dataset", ["one", "two"])
def test_folds_and_decision_values_are_those_of_tokt_train(dataset, workspace, tmp_path):
    version = open_dataset(dataset, workspace / "datasets")
    settings = replace(settings_named("plain"), penalties=(1.0,))
    split = Split.of(version, 4, 1)
    lbp = extractor_named("lbp_10_5_frame")
    request = TrainRequest(version, "m", lbp, "lbp", settings, replace(split, weight="patch"))
    held_out = fit_and_measure(request, tmp_path, lambda items, *_: items, 1).held_out

    X, y = load_dataset(version, return_X_y=True)
    cv = DiveSplit(n_splits=4, embargo_frames=1)
    assert cv.get_n_splits(X, y) == (4 if dataset == "one" else 2)
    for number, (train_rows, test_rows) in enumerate(cv.split(X, y)):
        assert np.flatnonzero(held_out.fold == number).tolist() == test_rows.tolist()
        assert not set(train_rows) & set(test_rows)
    assert number + 1 == cv.get_n_splits(X, y)
    svc = LinearSVC(C=1.0, dual=False, random_state=settings.seed, max_iter=5000)
    model = make_pipeline(LBP(border="frame"), StandardScaler(), svc)
    values = cross_val_predict(model, X, y, cv=cv, method="decision_function")
    assert same_bits(values, held_out.values[:, 0])


@pytest.mark.parametrize(("frames", "folds"), [("1,5,9,13,17,20", 6), ("1-20", 5), ("1-12", 4)])
def test_folds_left_open_are_as_many_as_the_labelled_frames_can_bear(
    frames, folds, workspace, tmp_path
):
    mission = workspace.parent / "east"
    labelled = set(parse_frames(frames))
    rows = [row for row in tiny_labels("east") if row[2] in labelled]
    write_labels(tmp_path / "labels.csv", rows)
    given = ("--mission", mission, "--labels", tmp_path / "labels.csv", "--block", 4)
    succeeds("dataset", "build", "few", *given, "--workspace", tmp_path / ".tokt")
    version = open_dataset("few", tmp_path / ".tokt" / "datasets")
    X, y = load_dataset(version, return_X_y=True)
    expected = Split.of(version, with_choices=False).cut(version.patches, version.targets())
    cut = list(DiveSplit().split(X, y))
    assert len(cut) == len(expected) == DiveSplit().get_n_splits(X, y) == folds
    for (train_rows, test_rows), fold in zip(cut, expected, strict=True):
        assert (train_rows.tolist(), test_rows.tolist()) == (
            fold.train.tolist(),
            fold.test.tolist(),
        )


def test_groups_and_labels_that_are_missing_are_named(one):
    table, y = LBP().transform(one.data[:10]), one.target[:10]
    groups = one.groups[:10].drop(columns="group")
    refuses("needs the mission, frame, group, site", DiveSplit().get_n_splits, table, y)
    refuses("needs the mission, frame, group, site", DiveSplit().get_n_splits, table, y, groups)
    refuses("a label for each of 10 patches", DiveSplit().get_n_splits, one.data[:10])
    for wrong in ({"n_splits": 1}, {"n_splits": "5"}, {"embargo_frames": -1}, {"by": "site"}):
        refuses("n_splits from 2", DiveSplit(**wrong).get_n_splits, one.data, one.target)


def test_a_grid_search_over_extractors_by_dive(workspace, tmp_path):
    X, y = load_dataset("two", workspace, return_X_y=True)
    X, y = X[::6], y[::6]
    model = Pipeline(
        [("features", LBP()), ("scaler", StandardScaler()), ("svc", LinearSVC(dual=False))],
        memory=str(tmp_path),
    )
    grid = {"features": [LBP(border="frame")], "svc__C": [0.1, 1.0]}
    finer = {"features": [LBP()], "features__radius": np.arange(1, 3)}
    search = GridSearchCV(model, [grid, finer], cv=DiveSplit(), scoring="f1")
    search.fit(X, y)
    assert search.n_splits_ == 2 and len(search.cv_results_["params"]) == 4
    assert search.best_score_ > 0.6
    best = clone(search.best_estimator_)
    train_rows, test_rows = next(DiveSplit().split(X, y))
    assert set(X.groups.mission.iloc[test_rows]) == {"east"}
    predicted = best.fit(X[train_rows], y[train_rows]).predict(X[test_rows])
    score = search.cv_results_["split0_test_score"][search.best_index_]
    assert f1_score(y[test_rows], predicted) == pytest.approx(score)


def test_features_once_computed_are_searched_with_the_groups_beside(one):
    table = make_union(LBP(), Haralick()).fit_transform(one.data)
    search = GridSearchCV(LinearSVC(dual=False), {"C": [0.1, 1.0]}, cv=DiveSplit(4, 2))
    search.fit(table, one.target, groups=one.groups)
    with config_context(enable_metadata_routing=True):
        routed = clone(search).fit(table, one.target, groups=one.groups)
    assert search.n_splits_ == routed.n_splits_ == 4
    assert search.cv_results_["mean_test_score"].tolist() == (
        routed.cv_results_["mean_test_score"].tolist()
    )


def test_tables_of_pandas_have_the_names_of_the_features(frames):
    union = make_union(LBP(), Haralick()).set_output(transform="pandas")
    table = union.fit_transform(patches_of(frames[:1]))
    assert isinstance(table, pd.DataFrame) and table.shape == (100, 25)
    assert table.columns[0] == "lbp__lbp_10_5_patch_0"
    alone = clone(LBP().set_output(transform="pandas")).transform(patches_of(frames[:1]))
    assert alone.columns.tolist() == list(extractor_named("lbp").names)


def test_a_pipeline_is_pickled_and_hashed_with_its_samples(one, frames):
    model = make_pipeline(LBP(), StandardScaler(), LinearSVC(dual=False))
    model.fit(one.data[::5], one.target[::5])
    again, X = pickle.loads(pickle.dumps((model, one.data[:200])))
    assert same_bits(again.decision_function(X), model.decision_function(one.data[:200]))
    told = patches_of(frames)
    assert joblib.hash(told) == joblib.hash(patches_of(frames)) != joblib.hash(told[1:])
    assert "LBP(radius=3)" in repr(make_pipeline(LBP(radius=3)))


# check_estimator skips what takes no table. So that its checks run, each estimator is put behind a
# table here: a row's values become a patch, and what follows is the estimator's own.
class BehindTable:
    def fit(self, X, y=None):
        return super().fit(drawn(validate_data(self, X)), y)

    def transform(self, X):
        return super().transform(drawn(validate_data(self, X, reset=False)))

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = True
        return tags


def drawn(table):
    """Patches of 27x36 pixels in colour, each by the values of one row."""
    grains = np.random.default_rng(0).integers(0, 64, (27, 36, 3))
    levels = [np.resize(row, (27, 36, 1)) for row in 8.0 * table]
    return [((grains + level.round()) % 256).astype(np.uint8) for level in levels]


class LBPTable(BehindTable, LBP):
    pass


class WaterFeaturesTable(BehindTable, WaterFeatures):
    pass


class PatchFeaturesTable(BehindTable, PatchFeatures):
    pass


TABLES = (LBPTable(), WaterFeaturesTable(), PatchFeaturesTable("haralick+lbp"))


@pytest.mark.parametrize("estimator", TABLES, ids=lambda estimator: type(estimator).__name__)
def test_scikit_learns_own_checks(estimator):
    """None fails; scikit-learn skips one where SCIPY_ARRAY_API is not set."""
    found = check_estimator(estimator, on_fail=None, on_skip=None)
    assert {one["check_name"]: one["exception"] for one in found if one["status"] == "failed"} == {}
    assert sum(one["status"] == "passed" for one in found) >= MIN_CHECKS


def test_scikit_learn_passes_over_what_takes_no_table():
    with pytest.warns(SkipTestWarning, match="two_d_array=False, three_d_array=True"):
        found = check_estimator(LBP())
    assert [one["status"] for one in found] == ["passed"]


def test_examples_of_the_docstrings():
    failed, tried = doctest.testmod(tokt.sklearn)
    assert not failed and tried >= 8
