"""The public names: all there and documented, loaded late, and the same work as the commands'."""

import inspect
import json
import shutil
from dataclasses import replace
from importlib import import_module
from itertools import product

import cv2
import pytest

import tokt
from tests.calls import refused, refuses, run_python, succeeds
from tests.fixtures import (
    BUILD_TINY,
    LABEL_COLUMNS,
    TRAIN_TINY,
    draw_tiny_frame,
    tiny_label,
    write_labels,
)
from tokt.features.common.extras import EXTRAS
from tokt.models.bundle.bundle import bundle_bytes, read_bundle
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.store.store import Store

WITHOUT = "import sys; sys.modules.update(dict.fromkeys({modules!r})); "
TRAINING = (
    *("CompareOptions", "Comparison", "DatasetOptions", "DatasetVersion", "EvaluateOptions"),
    *("TrainOptions", "TrainedVersion", "build_dataset", "compare", "evaluate", "train"),
)
OF_STUDIES = "simulate_mission"  # of tokt-studies
RUNTIME = sorted({*tokt.__all__} - {*TRAINING, OF_STUDIES})
COMMANDS = [
    ("dataset", "build", tokt.DatasetOptions, tokt.build_dataset),
    ("train", "train", tokt.TrainOptions, tokt.train),
    ("compare", "compare", tokt.CompareOptions, tokt.compare),
    ("compare", "evaluate", tokt.EvaluateOptions, tokt.evaluate),
]


def python(program, *arguments, without=()):
    ran = run_python("-c", WITHOUT.format(modules=without) + program, *arguments)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


@pytest.mark.parametrize("name", [name for name in tokt.__all__ if name != OF_STUDIES])
def test_a_public_name_is_what_it_is_called_and_says_what_it_is(name):
    found = getattr(tokt, name)
    assert found.__name__ == name and name in dir(tokt)
    assert len(inspect.getdoc(found)) > 20
    assert not inspect.getdoc(found).startswith(f"{name}(")  # a dataclass's own


@pytest.mark.parametrize("name", ["build_dataset", "train", "evaluate", "compare", "load_model"])
def test_what_users_call_is_documented_as_numpy_does(name):
    text = inspect.getdoc(getattr(tokt, name))
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert f"\n{section}\n{'-' * len(section)}\n" in text, section


def test_import_tokt_brings_nothing():
    """The runtime imports it at each start."""
    heavy = {"numpy", "cv2", "typer", "ast", "pathlib", "importlib.metadata"}
    program = (
        f"import tokt; print([one for one in {heavy} if one in sys.modules and one not in own])"
    )
    assert python(f"own = set(sys.modules); {program}") == "[]\n"


def test_the_runtimes_pieces_need_no_extra(tiny_bundle, tiny):
    """A plain install judges frames by the public names alone."""
    program = """
import tokt
pieces = [getattr(tokt, name) for name in sys.argv[3:]]
policy = tokt.SinglePolicy(tokt.TextureDetector(tokt.load_model(sys.argv[1])))
print([policy.judge(frame).verdict.status for frame in tokt.open_source(sys.argv[2])])
print(len(tokt.Labels.read(f"{sys.argv[2]}/labels.csv")))
"""
    said = python(program, tiny_bundle, tiny.path, *RUNTIME, without=tuple(EXTRAS)).splitlines()
    assert {*json.loads(said[0])} == {0, 1} and said[1] == "4000"


@pytest.mark.parametrize(
    ("guess", "name"),
    [
        *(
            (one, "load_model")
            for one in ("load", "Model", "open_model", "read_bundle", "open_bundle")
        ),
        *(("Dataset", "DatasetVersion"), ("Grd", "Grid"), ("judge", "judge_image")),
        *(("predict", "judge_image"), ("fit", "train"), ("score", "evaluate")),
    ],
)
def test_a_guessed_name_is_answered_with_the_public_one(guess, name):
    with pytest.raises(AttributeError, match=rf"no attribute '{guess}'; there is .*tokt\.{name}\b"):
        getattr(tokt, guess)


def test_a_name_like_none_is_only_refused():
    words = r"^module 'tokt' has no attribute 'xyz'; dir\(tokt\) lists the names, "
    with pytest.raises(AttributeError, match=words):
        tokt.xyz


def test_a_module_that_is_not_imported_yet_is_named():
    program = """
import tokt
try:
    tokt.mlflow
except AttributeError as error:
    print(error)
"""
    assert "has no attribute 'mlflow': import tokt.mlflow first" in python(program)


def test_what_is_no_model_and_no_picture_is_refused(tiny_bundle, tiny):
    model, picture = tokt.load_model(tiny_bundle), cv2.imread(str(tiny.path / "Left/tiny_L_30.png"))
    assert tokt.judge_image(model, picture).verdict.status in (0, 1)
    for wrong in (("waters", picture), (picture, model), (model, "a.jpg"), (model, None)):
        with pytest.raises(tokt.ToktError, match=r"judge_image takes a model of tokt\.load_model"):
            tokt.judge_image(*wrong)
    said = tokt.judge_image(model, picture / 255).verdict
    assert said.status == -1 and "float64" in said.health and "(uint8)" in said.health


def test_labels_that_are_no_file_are_refused(tiny):
    labels = tokt.Labels.read(tiny.labels)
    with pytest.raises(tokt.ToktError, match=r"not LabelRecord. Labels go into a file first"):
        tokt.build_dataset("tiny", mission=tiny.path, labels=labels)


def test_a_bundle_can_be_loaded_by_its_class(tiny_bundle):
    assert tokt.Bundle.load(tiny_bundle).sha256 == tokt.load_model(tiny_bundle).sha256


def test_a_missing_extra_is_named():
    program = """
import tokt
try:
    tokt.build_dataset
except ImportError as error:
    print(isinstance(error, tokt.ToktError), error)
"""
    words = "True tokt.build_dataset needs pandas: install the extra 'train'"
    assert python(program, without=("pandas",)).startswith(words)


@pytest.mark.parametrize(("module", "command", "options", "function"), COMMANDS)
def test_a_field_is_an_option_and_an_option_is_a_field(module, command, options, function):
    declared = inspect.signature(getattr(import_module(f"tokt.cli.{module}"), command)).parameters
    asked = {name: one.default for name, one in declared.items() if name != "json"}
    defaults = {name: one.default for name, one in inspect.signature(options).parameters.items()}
    assert defaults == asked
    assert inspect.signature(function).parameters == inspect.signature(options).parameters


@pytest.fixture(scope="module")
def api_workspace(tiny, trained, tmp_path_factory):
    """The dataset and the model of `trained`, made by the functions."""
    workspace = tmp_path_factory.mktemp("api")
    shutil.copy(trained / "mlflow.db", workspace)  # making its tables takes seconds
    block, (folds, embargo) = BUILD_TINY[1], TRAIN_TINY[1::2]
    data = tokt.build_dataset(
        "tiny", mission=str(tiny.path), labels=tiny.labels, block=block, workspace=workspace
    )
    options = tokt.TrainOptions(
        *("tiny", "lbp", "plain"), folds=folds, embargo=embargo, workspace=workspace, name="api"
    )
    steps = []

    def progress(items, total, what):
        steps.append(what)
        return items

    return workspace, data, tokt.train(options, progress=progress), steps


def test_the_functions_make_what_the_commands_make(api_workspace, trained):
    workspace, data, version, steps = api_workspace
    said = json.loads(succeeds("dataset", "show", "tiny", "--json", "--workspace", trained).out)
    assert (data.hash, data.label) == (said["hash"], said["label"])
    assert repr(data).startswith("DatasetVersion('tiny@") and "patches in 40 frames" in repr(data)
    shown = json.loads(succeeds("models", "show", "tiny-lbp", "--json", "--workspace", trained).out)
    assert json.loads(json.dumps(version.metrics)) == shown["metrics"]
    assert version.operating_point.to_json() == shown["operating_point"]
    assert version.label == "api/1" and "F1 0." in repr(version) and steps
    theirs, ours = tokt.load_model("tiny-lbp", trained), version.bundle()
    assert repr(ours) == "Bundle('api/1': 12 features of a patch, grid 10x10@360)"
    assert (ours.model.weights == theirs.model.weights).all()
    assert tokt.load_model("api/1", str(workspace)).sha256 == ours.sha256


def test_evaluate_and_compare_are_the_commands(trained, tiny, tiny_bundle, workspace, tmp_path):
    where = {"mission": tiny.path, "labels": str(tiny.labels), "workspace": trained}
    notes = []
    model, figures = tokt.evaluate(
        tokt.EvaluateOptions("tiny-lbp", frames="1-20", **where), notice=notes.append
    )
    about = ("--mission", tiny.path, "--labels", tiny.labels, "--workspace", trained, "--json")
    ran = succeeds("evaluate", "tiny-lbp", *about, "--frames", "1-20")
    assert json.loads(ran.out) == json.loads(json.dumps(figures))
    assert model.label == "tiny-lbp/1"
    assert ran.err.splitlines()[-1:] == notes and "learnt from 20 of these frames" in notes[0]
    # On frames that neither has seen; the other model is the first one that looks away more.
    dive, content = tmp_path / "later", read_bundle(tiny_bundle).content
    (dive / "Left").mkdir(parents=True)
    for frame in range(100, 112):
        cv2.imwrite(str(dive / "Left" / f"later_L_{frame}.png"), draw_tiny_frame(frame))
    patches = product(range(100, 112), range(10), range(10))
    rows = [["later", "left", *patch, tiny_label(*patch)] for patch in patches]
    labels = write_labels(tmp_path / "later.csv", rows)
    other = replace(content, name="other", operating_point=OperatingPoint(MofNRule(2.0)))
    (tmp_path / "other.tokt").write_bytes(bundle_bytes(other))
    names = ["tiny-lbp", str(tmp_path / "other.tokt")]
    found = tokt.compare(names, mission=dive, labels=labels, workspace=workspace)
    on = ("--mission", dive, "--labels", labels, "--workspace", workspace, "--json")
    said = json.loads(succeeds("compare", *names, *on).out)
    assert found.words == said["words"] and found.words[0] in repr(found)
    table = found.to_pandas()
    assert [*table.index] == said["ranking"]
    assert table.f1.to_dict() == {one["model"]: one["patch"]["f1"] for one in said["models"]}
    assert table.ocean_frames.max() > 0 and table.median_ms.min() > 0
    assert found.html.startswith("<!DOCTYPE html>") or "<html" in found.html
    assert len(found.log()) == 32


def test_a_wrong_option_is_said_in_one_line(trained, tmp_path):
    refuses("give either --mission DIR or --patches DIR", tokt.build_dataset, "x")
    refuses("compare needs at least two models", tokt.compare, "tiny-lbp", workspace=trained)
    refuses("--site is something like", tokt.train, "tiny", site="x", workspace=trained)
    refuses("no dataset 'none'", tokt.train, "none", workspace=tmp_path)
    where = {"max_samples": 5000, "preset": "thesis", "workspace": trained}
    refuses("no --max-samples", tokt.train, "tiny", **where)
    refuses("--folds is at least 2, not 1", tokt.train, "tiny", folds=1, workspace=trained)
    with pytest.raises(TypeError, match="presett"):
        tokt.train("tiny", presett="best")


def test_a_grid_and_a_number_are_given_as_such(tiny, trained, tmp_path):
    """And what a command takes as text, as text."""
    about = {"mission": tiny.path, "labels": tiny.labels, "frames": "1-12", "workspace": tmp_path}
    made = [tokt.build_dataset("grid", grid=one, **about) for one in (tokt.Grid(), "10x10")]
    assert made[0].hash == made[1].hash
    split = dict(zip(("folds", "embargo"), TRAIN_TINY[1::2], strict=True))
    about = {"preset": "plain", "least_patches": 101, "workspace": trained, **split}
    refuses("frames of 100 patches never show 101", tokt.train, "tiny", **about)
    assert len(tokt.Labels.read(tiny.labels, grid=tokt.Grid())) == 4000
    assert "label" in tokt.Labels(()).to_pandas()


def test_a_users_own_mlflow_run_stays_theirs(workspace, tmp_path, monkeypatch):
    import mlflow

    place = (tmp_path / "own").resolve()
    place.mkdir()
    split = dict(zip(("folds", "embargo"), TRAIN_TINY[1::2], strict=True))
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{place}/mlflow.db")
    mlflow.set_tracking_uri(f"sqlite:///{place}/mlflow.db")
    with mlflow.start_run() as own:
        version = tokt.train("tiny", "lbp", "plain", **split, workspace=workspace)
        assert mlflow.active_run().info.run_id == own.info.run_id
        monkeypatch.delenv("MLFLOW_TRACKING_URI")
        refuses("run of another MLflow registry is active", tokt.load_model, "m", workspace)
    logged = mlflow.get_run(version.registered.run_id)
    assert logged.data.tags["mlflow.parentRunId"] == own.info.run_id
    assert mlflow.get_run(own.info.run_id).info.status == "FINISHED"


def test_a_model_is_loaded_from_registry_file_or_store(trained, tiny_bundle, tmp_path, monkeypatch):
    bundle = read_bundle(tiny_bundle)
    Store(tmp_path / "store").deploy(bundle, "test")
    for reference in ("tiny-lbp", "tiny-lbp@challenger", "tiny-lbp/1", tiny_bundle,
                      str(tiny_bundle), tmp_path / "store", str(tmp_path / "store")):  # fmt: skip
        assert tokt.load_model(reference, trained).sha256 == bundle.sha256
    # A folder of frames that is called as a model is no store.
    (tmp_path / "tiny-lbp").mkdir()
    monkeypatch.chdir(tmp_path)
    assert tokt.load_model("tiny-lbp", trained).sha256 == bundle.sha256
    ran = succeeds("models", "show", "store", "--json", "--workspace", tmp_path / "none")
    assert json.loads(ran.out)["sha256"] == bundle.sha256
    refuses("no model has been trained", tokt.load_model, "other", tmp_path / "none")


def test_an_active_model_is_not_taken_for_a_signed_registration(tiny_bundle, tmp_path, trained):
    """`--registered-by` vouches for what a registry holds: of a store nobody signed that."""
    Store(tmp_path / "store").deploy(read_bundle(tiny_bundle), "test")
    about = ("-o", tmp_path / "m.tokt", "--registered-by", tmp_path / "k.pub")
    refused("goes with a registered model", "export", tmp_path / "store", *about)


def test_labels_are_read_counted_written_and_stored(tiny, tmp_path, own_tiny):
    labels = tokt.Labels.read(tiny.labels)
    counts = labels.counts()
    assert sum(counts.values()) == len(labels) == len([*labels]) == 4000
    assert set(counts) == {"ocean", "subsea_installation", "unsure"}
    assert repr(labels).startswith("Labels(4000 records: {'ocean': ")
    table = labels.to_pandas()
    assert table.label.value_counts().to_dict() == counts
    assert {*LABEL_COLUMNS} < {*table} and set(table.grid) == {"10x10@360"}

    lost = labels.write(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == tiny.labels.read_bytes()
    assert lost == ["4000 labels without annotator and time (--full keeps them)"]
    about = {"mission_dir": own_tiny.path}
    assert labels.write(tmp_path / "coco.json", format="coco", **about) is not None
    again = tokt.Labels.read(tmp_path / "coco.json", **about)
    assert again.counts() == counts and again.format == "coco"

    workspace = tmp_path / "ws"
    assert labels.add_to(workspace).new == 4000
    said = json.loads(succeeds("labels", "stats", "--json", "--workspace", workspace).out)
    assert said["annotators"][0]["counts"] == counts
    assert tokt.Labels.stored(workspace).counts() == counts
    assert len(tokt.Labels.stored(workspace, annotator="nobody")) == 0
    refuses("no label store", tokt.Labels.stored, tmp_path / "none")


def test_a_run_is_described_by_its_options(tiny_bundle, tiny, tmp_path):
    options = {"source": tiny.path, "bundle": str(tiny_bundle), "log": str(tmp_path / "run.jsonl")}
    options["udp"] = "127.0.0.1:1131"
    summary = tokt.run(tokt.RunConfig.of(options))
    frames = [line for line in tokt.read_log(tmp_path / "run.jsonl") if "frame" in line]
    assert summary.frames == len(frames) == 40
    assert sum(line["status"] == 1 for line in frames) == summary.obstacle > 0
    model = tokt.load_model(tiny_bundle)
    policy = tokt.SinglePolicy(tokt.TextureDetector(model))
    judged = [policy.judge(frame).verdict for frame in tokt.open_source(tiny.path)]
    assert [verdict.status for verdict in judged] == [line["status"] for line in frames]
    refuses("did you mean log_values", tokt.RunConfig.of, {"log-values": True})
    refuses("for the command tokt run", tokt.run, tokt.RunConfig.of({"watchdog": True}))
