"""A bundle that carries what its model learnt from: training goes on from it, without a picture."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.calls import call_tokt, refuses
from tests.fixtures import quiet
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes, unzip, zip_bytes
from tokt.models.registry.registry import Registry
from tokt.training.datasets.changed_patches import changed_patches
from tokt.training.datasets.dataset import open_dataset, write_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.split import Split
from tokt.training.fitting.adapt import packaged_model
from tokt.training.fitting.carried import carried_bytes, install_carried
from tokt.training.fitting.plan_of_rows import plan_of_rows
from tokt.training.fitting.train import TrainRequest, fit_and_measure

CHANGES = "random_2"
FRAMES = (2, 9, 17, 26, 34)
KEPT = 12


@pytest.fixture(scope="module")
def carrying(tiny_dive, begun, done, told, tmp_path_factory):
    """A model of two dives, its dataset with pictures and with rows, and the bundle with these."""
    folder = tmp_path_factory.mktemp("carried")
    where = ("--workspace", begun(folder / ".tokt"))
    given = []
    for name, gain in (("one", 1.0), ("two", 1.4)):
        labels = tiny_dive(folder / name, range(1, 31), gain)
        given += ["--mission", folder / name, "--labels", labels]
    told("dataset", "build", "pictures", *given, "--block", 4, *where)
    train = ("--extractor", "haralick", "--preset", "plain", "--changes", CHANGES)
    done("train", "pictures", *train, "--embargo", 1, "--name", "tower", *where)
    workspace = folder / ".tokt"
    registry, pictures = Registry(workspace), open_dataset("pictures", workspace / "datasets")
    bundle, logged = registry.bundle("tower/1"), registry.parameters(registry.find("tower/1"))
    spec, cache = bundle.extractor.spec, workspace / "cache"
    features = cached_features(pictures, spec, cache, quiet, 1, whole_frames=True)
    changed = changed_patches(pictures, spec, CHANGES, cache, quiet, 1)
    plan = plan_of_rows(pictures, "begin", bundle.extractor, CHANGES, features, changed, KEPT)
    rows = write_dataset(plan, folder / "rows", quiet)
    data = bundle_bytes(replace(bundle.content, name="begin", dataset=carried_bytes(rows, logged)))
    new = folder / "night", tiny_dive(folder / "night", range(1, 41), 0.6, FRAMES)
    return {
        **{"pictures": pictures, "features": features, "changed": changed, "rows": rows},
        **{"bundle": bundle_from_bytes(data, "begin"), "new": new, "logged": logged, "plan": plan},
    }


def test_rows_stand_for_the_pictures(carrying, tmp_path):
    rows, pictures, bundle = carrying["rows"], carrying["pictures"], carrying["bundle"]
    assert not rows.pictured.any() and pictures.pictured.all() and not rows.is_gray
    assert rows.frames.groupby("mission").size().tolist() == [KEPT, KEPT]
    merged = rows.patches.merge(
        pictures.patches.reset_index(), on=["mission", "camera", "frame", "row", "col"]
    )
    assert len(merged) == len(rows.patches) and (merged.label_x == merged.label_y).all()
    spec = bundle.extractor.spec
    found = cached_features(rows, spec, tmp_path, quiet, 1, whole_frames=True)
    exact = carrying["features"][merged["index"]]
    of_changed = carrying["changed"].features[carrying["changed"].source >= 0]
    step = 6 / 15 * np.concatenate([carrying["features"], of_changed]).std(axis=0)
    assert (np.abs(found[: len(exact)] - exact) <= step).mean() > 0.95
    changed = changed_patches(rows, spec, CHANGES, tmp_path, quiet, 1)
    assert len(changed.of(np.arange(len(rows.patches)))) > 0.5 * 25 * 2 * len(rows.frames)
    # The same labels, and the same mean of each class.
    for target in (0, 1):
        of_rows = changed.features[rows.targets()[changed.source] == target].mean(axis=0)
        source = carrying["changed"].source
        of_pictures = (
            carrying["changed"]
            .features[(source >= 0) & (pictures.targets()[source] == target)]
            .mean(axis=0)
        )
        assert (np.abs(of_rows - of_pictures) < 2 * step).all()


def test_it_says_that_it_has_no_pictures(carrying, tmp_path):
    rows, spec = carrying["rows"], carrying["bundle"].extractor.spec
    refuses("has features of frame 1 of one, and no picture", rows.read_frame, 0)
    cache = tmp_path / "cache"
    refuses("no pictures that gain_2 could change",
            cached_features, rows, spec, cache, quiet, 1, None, "gain_2")  # fmt: skip
    refuses(
        "of another extractor",
        cached_features,
        rows,
        {**spec, "ignore_zeros": True},
        cache,
        quiet,
        1,
    )
    refuses("of another extractor", changed_patches, rows, spec, "random_9", cache, quiet, 1)
    refuses("has pictures, which no bundle", carried_bytes, carrying["pictures"], {})


def test_a_model_is_trained_on_rows_alone(carrying, tmp_path):
    """As well as on the pictures, which are easy ones."""
    rows, bundle = carrying["rows"], carrying["bundle"]
    known = packaged_model(bundle, tmp_path / "datasets")
    split = Split.of(rows, 5, 1)
    request = TrainRequest(rows, "again", bundle.extractor, "haralick", known.settings, split)
    refuses("tokt adapt goes on from it", fit_and_measure, request, tmp_path, quiet, 1)
    request = replace(request, known_sight=bundle.sight)
    trained = fit_and_measure(request, tmp_path, quiet, 1)
    assert trained.metrics["patch"]["f1"] > 0.95


def test_a_bundle_carries_it_and_a_workspace_takes_it(carrying, tmp_path):
    bundle, rows = carrying["bundle"], carrying["rows"]
    for _ in range(2):
        carried = install_carried(bundle, tmp_path)
        assert carried.dataset.hash == rows.hash and carried.parameters == carrying["logged"]
    assert [path.name for path in tmp_path.iterdir()] == ["begin"]
    assert carried.dataset.patches.equals(rows.patches)
    lost = next((carried.dataset.path / "frames").iterdir())
    lost.unlink()
    assert (install_carried(bundle, tmp_path).dataset.path / "frames" / lost.name).is_file()
    again = write_dataset(carrying["plan"], tmp_path / "again", quiet)
    assert carried_bytes(again, carrying["logged"]) == bundle.dataset
    bare = bundle_from_bytes(bundle_bytes(replace(bundle.content, dataset=None)), "bare")
    refuses("carries no dataset to go on from", install_carried, bare, tmp_path)


@pytest.mark.parametrize("fault", ["zip", "parameters", "settings", "other", "rows", "name"])
def test_a_damaged_dataset_is_refused(carrying, tmp_path, fault):
    bundle = carrying["bundle"]
    members = unzip(bundle.dataset, "x")
    words = "is damaged"
    if fault == "parameters":
        members["parameters.json"] = b"[]"
    elif fault == "settings":
        members["parameters.json"], words = b"{}", "what it was trained with is damaged"
    elif fault == "name":
        members["dataset.json"] = members["dataset.json"].replace(b'"begin"', b'"../../x"')
        words = "dataset name '../../x'"
    elif fault == "other":
        members["frames/../../x"], words = b"x", "has files of other kinds"
    elif fault == "rows":
        name = next(name for name in members if name.endswith(".parquet"))
        members[name], words = members[name][:-9], "is missing or damaged"
    data = b"no zip" if fault == "zip" else zip_bytes(members)
    refuses(words if fault != "zip" else "truncated or damaged",
            packaged_model, replace(bundle, dataset=data), tmp_path / "datasets")  # fmt: skip
    assert not (tmp_path / "x").exists()


def test_adapt_goes_on_from_it_to_a_model_of_ones_own(carrying, tmp_path, monkeypatch, told):
    """No registry, no dataset: the command makes both. The next dive goes on from the result."""
    file = tmp_path / "waters.tokt"
    file.write_bytes(carrying["bundle"].data)
    for module in ("tokt.models.registry.load", "tokt.models.pretrained.packaged"):
        monkeypatch.setattr(f"{module}.packaged_bundle", lambda name: file)
    where = ("--draws", 1, "--workspace", tmp_path / ".tokt")
    path, labels = carrying["new"]
    found = told("adapt", "waters", "--mission", path, "--labels", labels, *where)
    assert found["model"]["name"] == "begin-night" and found["model"]["version"] == "1"
    adaptation = found["adaptation"]
    assert adaptation["before"] == "begin/1" and set(adaptation["lost"]) == {"one", "two"}
    assert adaptation["gained"] is not None and adaptation["worse"] == []
    registry = Registry(tmp_path / ".tokt")
    bundle = registry.bundle("begin-night/1")
    assert bundle.dataset is None and not bundle.deployment_fault
    sizes = set(carrying["bundle"].frame_sizes)
    assert set(bundle.frame_sizes) == sizes and bundle.sight
    other = path.rename(path.with_name("noon"))
    text = labels.with_name("labels.csv") if labels.exists() else other / "labels.csv"
    text.write_text(text.read_text().replace("night", "noon"))
    for one in (other / "Left").iterdir():
        one.rename(one.with_name(one.name.replace("night", "noon")))
    ran = call_tokt("adapt", "begin-night", "--mission", other, "--labels", text, *where)
    # Its pictures are copies of the first dive's: nothing can be told of them, and all goes well.
    assert ran.code == 0, ran.err
    assert "begin-night/2 beside begin-night/1" in ran.out
    listed = json.loads(call_tokt("compare", "begin-night/1", "begin-night/2", "--json",
                                  "-o", tmp_path / "page.html", *where[2:]).out)  # fmt: skip
    assert len(listed["models"]) == 2
