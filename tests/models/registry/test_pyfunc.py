"""A registered model as MLflow loads and serves it: the runtime's verdicts, bit for bit."""

import base64
import json
import pickle
import re
import shutil
import subprocess
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path

import cv2
import mlflow
import numpy as np
import pandas as pd
import pytest
from mlflow.exceptions import MlflowException

from tests.calls import call_tokt, refuses, succeeds
from tests.fixtures import ROOT, TRAIN_TINY, draw_tiny_frame
from tests.inference.test_faults import hold_row
from tests.models.registry.serving import mlflow_serves
from tokt.features.frames.image_file import read_image
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.texture.detector import TextureDetector
from tokt.mlflow import FOLDER_VARIABLE, TextureModel, frames_array
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes, read_bundle
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.registry.registration import NUMBER_TAG
from tokt.models.registry.registry import BUNDLE_FILE, Registry

TRAIN = ("train", "tiny", "--extractor", "lbp", "--preset", "plain", *TRAIN_TINY)


@pytest.fixture(scope="module")
def trained_twice(trained, tmp_path_factory):
    """A workspace with versions 1 and 2 of `tiny-lbp`; not to be changed."""
    workspace = tmp_path_factory.mktemp("twice") / ".tokt"
    shutil.copytree(trained, workspace)
    assert train_again(workspace)["version"] == "2"
    return workspace


@pytest.fixture
def twice(trained_twice, tmp_path):
    """A copy of `trained_twice` that a test may change, known to MLflow's own tools."""
    copy = shutil.copytree(trained_twice, tmp_path / "twice")
    Registry(copy).experiment_id()
    return copy


@pytest.fixture
def model(trained):
    """As a user of MLflow loads it."""
    Registry(trained)  # makes the workspace MLflow's own
    return mlflow.pyfunc.load_model("models:/tiny-lbp/1")


@pytest.fixture(scope="module")
def frames():
    """Some of the tiny mission's, across a block's border, and one that is too dark to judge."""
    return [*map(draw_tiny_frame, range(1, 11)), np.zeros((272, 360), np.uint8)]


@pytest.fixture(scope="module")
def expected(tiny_bundle, frames):
    return judged_by_the_runtime(read_bundle(tiny_bundle), frames)


def judged_by_the_runtime(bundle, frames):
    policy = SinglePolicy(TextureDetector(bundle))
    return [policy.judge(Frame(n, 0.0, frame, None)) for n, frame in enumerate(frames)]


def mask_of(text):
    return cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_UNCHANGED)


def assert_same(rows, judgements):
    """Bit for bit, what could not be judged too."""
    assert len(rows) == len(judgements)
    for row, judged in zip(rows, judgements, strict=True):
        verdict, values = judged.verdict, judged.decision_values
        for name in ("status", "x", "y", "mean", "health", "model"):
            assert row[name] == getattr(verdict, name), name
        assert row["reason"] == verdict.reason.value
        assert row["box"] == (None if verdict.box is None else list(verdict.box))
        if values is None:
            assert row["decision_values"] is None and row["patches"] is None
        else:
            assert np.array(row["decision_values"], np.float64).tobytes() == values.tobytes()
        if judged.mask is None:
            assert row["mask"] is None
        else:
            mask = mask_of(row["mask"])
            assert (mask.dtype, mask.shape) == (judged.mask.dtype, judged.mask.shape)
            assert mask.tobytes() == judged.mask.tobytes()


def records(table):
    return table.to_dict("records")


def png(frame):
    return cv2.imencode(".png", frame)[1].tobytes()


def as_text(frame):
    return base64.b64encode(png(frame)).decode()


def test_arrays(model, frames, expected):
    assert {judged.verdict.status for judged in expected} == {-1, 0, 1}
    table = model.predict(np.stack(frames))
    assert_same(records(table), expected)
    assert set(table.model[table.status >= 0]) == {"tiny-lbp/1"}
    patches = model.get_raw_model().model.obstacle_patches(np.array(table.decision_values[5]))
    assert table.patches[5] == patches.tolist() and any(table.patches[5])
    assert_same(records(model.predict(frames[0])), expected[:1])
    coloured = [cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR) for frame in frames]
    assert_same(records(model.predict(np.stack(coloured))), expected)
    assert_same(records(model.predict(coloured[0])), expected[:1])


def test_frames_of_several_kinds_and_sizes(model, frames, expected, tmp_path):
    (tmp_path / "two.png").write_bytes(png(frames[1]))
    small = cv2.resize(frames[3], (90, 68))
    mixed = frames_array([frames[0], tmp_path / "two.png", png(frames[2]), small])
    rows = records(model.predict(mixed))
    assert_same(rows[:3], expected[:3])
    assert rows[3]["reason"] == "wrong_size" and rows[3]["status"] == -1
    (array,) = frames_array([np.zeros((2, 3, 3), np.uint8)])  # not taken apart
    assert array.shape == (2, 3, 3)


def test_a_table_and_text(model, frames, expected):
    texts = list(map(as_text, frames))
    assert_same(records(model.predict(pd.DataFrame({"frame": texts}))), expected)
    assert_same(records(model.predict(np.array(texts, object))), expected)
    texts[0] = f"data:image/png;base64,{texts[0]}"
    extra = pd.DataFrame({"what": "x", "frame": texts})
    assert_same(records(model.predict(extra)), expected)
    raw = TextureModel(model.get_raw_model())  # MLflow itself lets no list pass
    assert_same(records(raw.predict(texts)), expected)
    assert_same(records(raw.predict(texts[1])), expected[1:2])


def test_paths_as_text_are_of_one_folder_alone(model, tiny, tmp_path, monkeypatch):
    files = [tiny.path / "Left" / f"tiny_L_{number}.png" for number in (1, 2, 3)]
    wanted = judged_by_the_runtime(model.get_raw_model(), map(read_image, files))
    table = pd.DataFrame({"frame": list(map(str, files))})

    def refuses_text(words, paths):
        with pytest.raises(MlflowException, match=words) as caught:
            model.predict(pd.DataFrame({"frame": paths}))
        assert caught.value.error_code == "INVALID_PARAMETER_VALUE"
        assert "\n" not in caught.value.message and "tiny_L" not in caught.value.message

    refuses_text("unless TOKT_FRAMES names their folder", list(map(str, files)))
    monkeypatch.setenv(FOLDER_VARIABLE, str(tiny.path))
    assert_same(records(model.predict(table)), wanted)
    relative = pd.DataFrame({"frame": [f"Left/{file.name}" for file in files]})
    assert_same(records(model.predict(relative)), wanted)
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "link.png").symlink_to(files[0])
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "inside"))
    for path in (str(files[0]), "link.png", "../x.png", "/etc/resolv.conf"):
        refuses_text("outside the folder", [path])
    refuses_text("cannot be followed", ["a\0.png"])
    assert_same(records(model.predict(frames_array(files))), wanted)  # `Path` is of this process
    hold_row(
        "a path sent to a served model",
        f"refused, unless it is below the folder that `{FOLDER_VARIABLE}` names",
        "nothing",
    )


def test_what_cannot_be_read_is_unknown(model, frames, tmp_path, monkeypatch):
    bad = [tmp_path / "none.png", png(frames[0])[:-20], b"", base64.b64encode(b"no image").decode()]
    table = model.predict(frames_array([*bad, frames[1]]))
    assert table.reason.tolist() == ["unreadable"] * 4 + ["ok"]
    assert table.status.tolist()[:4] == [-1] * 4
    assert all(value is None for value in table.x[:4])
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    said = model.predict(pd.DataFrame({"frame": ["none.png"]})).health[0]
    assert said == "none.png: No such file or directory"  # nor where the folder is


def test_what_is_no_frame_is_refused(model):
    for wrong in (
        np.zeros((4, 4)),
        np.zeros(3, np.uint8),
        frames_array([5]),
        frames_array([None]),
        frames_array(["no base64!"]),
        frames_array([np.zeros((4, 4), np.uint16)]),
    ):
        with pytest.raises(MlflowException, match="tokt: ") as caught:
            model.predict(wrong)
        assert "\n" not in caught.value.message
    for wrong in ({"other": ["x"]}, 5):
        with pytest.raises(MlflowException, match="tokt: "):
            TextureModel(model.get_raw_model()).predict(wrong)


def test_frames_of_one_call_are_one_dive(model, tiny_bundle, frames):
    """Another call, or `independent`, knows nothing of the frames before."""
    loaded = model
    point = OperatingPoint(MofNRule(0.0, 1, 2, 3))
    content = replace(read_bundle(tiny_bundle).content, operating_point=point)
    model = TextureModel(bundle_from_bytes(bundle_bytes(content), "remembers"))
    dive = judged_by_the_runtime(model.bundle, frames)
    alone = [judged_by_the_runtime(model.bundle, [frame])[0] for frame in frames]
    assert [judged.verdict.status for judged in dive] != [each.verdict.status for each in alone]
    for _ in range(2):
        assert_same(records(model.predict(np.stack(frames))), dive)
    assert_same(records(model.predict(np.stack(frames), {"independent": True})), alone)
    with pytest.raises(MlflowException, match="Can not safely convert"):
        loaded.predict(frames[0], params={"independent": "often"})


def test_its_bundle_is_the_exported_one(trained, tiny_bundle, tmp_path):
    Registry(trained)
    folder = mlflow.artifacts.download_artifacts("models:/tiny-lbp/1", dst_path=str(tmp_path))
    assert (Path(folder) / "data" / BUNDLE_FILE).read_bytes() == tiny_bundle.read_bytes()
    kinds = {path.suffix for path in Path(folder).rglob("*")}
    assert not kinds & {".pkl", ".pickle", ".joblib", ".skops"}
    info = mlflow.models.get_model_info("models:/tiny-lbp/1")
    assert list(info.flavors) == ["python_function"]
    assert info.flavors["python_function"]["loader_module"] == "tokt.mlflow"
    assert "tokt==" in (Path(folder) / "requirements.txt").read_text()
    assert info.signature.outputs.input_names()[0] == "status"


def test_its_example_is_judged(model):
    row = records(model.predict(model.input_example))[0]
    golden = model.get_raw_model().golden.decision_values[0]
    np.testing.assert_allclose(row["decision_values"], golden, rtol=0, atol=1e-9)


def test_a_bundle_that_fails_a_check_is_not_loaded(workspace, tmp_path):
    Registry(workspace).experiment_id()  # from now on MLflow's own tools know where it is
    (file,) = (workspace / "mlartifacts" / "models").glob(f"*/artifacts/data/{BUNDLE_FILE}")
    before = file.read_bytes()
    for data in (
        before[:-100],
        pickle.dumps(0),
        before.replace(b'"version": "1"', b'"version": "2"'),
    ):
        file.write_bytes(data)
        refuses("model.tokt", mlflow.pyfunc.load_model, "models:/tiny-lbp/1")
        refuses("model.tokt is not the one", Registry(workspace).bundle, "tiny-lbp")
        refuses(
            "model.tokt is not the one",
            Registry(workspace).check,
            Registry(workspace).find("tiny-lbp"),
        )


def test_another_models_bundle_in_its_place(twice):
    """Whole by itself: MLflow does not ask the registration, tokt does."""
    workspace, registry = twice, Registry(twice)
    found = [ids(registry.find(f"tiny-lbp/{number}"), registry)[1] for number in (1, 2)]
    one, two = (workspace / "mlartifacts" / "models" / each / "artifacts" for each in found)
    shutil.copyfile(two / "data" / BUNDLE_FILE, one / "data" / BUNDLE_FILE)
    refuses("model.tokt is not the one that was registered", registry.bundle, "tiny-lbp/1")
    said = "model tiny-lbp/1: its bundle is of tiny-lbp/2"
    refuses(said, mlflow.pyfunc.load_model, "models:/tiny-lbp/1")
    # Under another name it is a copy, as MLflow's users promote models; it says whose.
    mlflow.MlflowClient().copy_model_version("models:/tiny-lbp/2", "production")
    copy = mlflow.pyfunc.load_model("models:/production/1")
    assert copy.get_raw_model().label == "tiny-lbp/2"
    refuses("production/1: its files were registered as 'tiny-lbp'", registry.bundle, "production")
    hold_row(
        "another model's bundle in the place of a registered one's",
        "refused: `is not the one that was registered`; by MLflow's loader where it is another "
        "number of the same name",
        "nothing",
    )


def test_the_page_about_it_says_what_works(workspace, tiny, monkeypatch):
    page = (ROOT / "docs" / "how-to" / "mlflow.md").read_text("utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    code = code.replace("tower-lbp@champion", "tiny-lbp@challenger")
    (workspace.parent / "dive").symlink_to(tiny.path)
    monkeypatch.chdir(workspace.parent)
    bundle = Registry(workspace).bundle("tiny-lbp")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "")  # where MLflow keeps what the page sets
    found = {}
    exec(code, found)
    frames = map(draw_tiny_frame, range(1, 41))
    assert_same(records(found["table"]), judged_by_the_runtime(bundle, frames))
    for column in found["table"]:
        assert f"`{column}`" in page or column == "model"


def train_again(workspace):
    return json.loads(succeeds(*TRAIN, "--json", "--workspace", workspace).out)["model"]


def ids(version, registry):
    """Of its run and of MLflow's model."""
    return version.run_id, registry.recipe(version)["provenance"]["mlflow_model_id"]


def test_comparing_within_a_run_of_the_users(twice, tmp_path):
    """As in a notebook, where MLflow would refuse a second run that is not said to be nested."""
    with mlflow.start_run() as run:
        labels = ("tiny-lbp/1", "tiny-lbp/2")
        succeeds("compare", *labels, "-o", tmp_path / "c.html", "--workspace", twice)
        assert mlflow.active_run().info.run_id == run.info.run_id


def assert_numbers_fit(workspace):
    registry = Registry(workspace)
    for version in registry.versions():
        assert registry.bundle(version.label).label == version.label
        pyfunc = mlflow.pyfunc.load_model(f"models:/{version.label}")
        assert pyfunc.get_raw_model().data == registry.bundle(version.label).data


def test_a_number_that_another_training_took(workspace, monkeypatch):
    """Between the question for the next number and the registration."""
    whole, taken = Registry.register, []

    def raced(self, name, *rest):
        if not taken:
            taken.append(1)
            run_id, model_id = ids(self.find("tiny-lbp/1"), self)
            whole(self, name, f"models:/{model_id}", run_id, model_id, {NUMBER_TAG: "tiny-lbp/9"})
        return whole(self, name, *rest)

    monkeypatch.setattr(Registry, "register", raced)
    assert train_again(workspace) == {"name": "tiny-lbp", "version": "4", "aliases": ["challenger"]}
    labels = [version.label for version in Registry(workspace).versions()]
    assert labels == ["tiny-lbp/4", "tiny-lbp/1"]  # 2 is not its own, 3 was withdrawn
    assert_numbers_fit(workspace)
    _, model_id = ids(Registry(workspace).find("tiny-lbp"), Registry(workspace))
    logged = mlflow.MlflowClient().get_logged_model(model_id)
    assert len({(m.key, m.step) for m in logged.metrics}) == len(logged.metrics)


def test_a_number_that_was_deleted_is_not_given_again(twice):
    mlflow.MlflowClient().delete_model_version("tiny-lbp", "2")
    assert int(train_again(twice)["version"]) > 2
    assert_numbers_fit(twice)


def test_killed_before_a_wrong_number_was_withdrawn(workspace, monkeypatch):
    """MLflow has the version, and neither tokt nor the loader takes it."""
    monkeypatch.setattr(Registry, "next_number", lambda *_: 7)
    monkeypatch.setattr(Registry, "withdraw", lambda *_: 1 / 0)
    assert call_tokt(*TRAIN, "--workspace", workspace).code == 70
    monkeypatch.undo()
    assert [version.label for version in Registry(workspace).versions()] == ["tiny-lbp/1"]
    refuses("has no version 2", Registry(workspace).find, "tiny-lbp/2")
    said = "model tiny-lbp/2: its bundle is of tiny-lbp/7"
    refuses(said, mlflow.pyfunc.load_model, "models:/tiny-lbp/2")
    assert Registry(workspace).next_number("tiny-lbp") == 3


@pytest.fixture
def served(trained, tmp_path):
    words = ("models", "serve", "--env-manager", "local", "--model-uri", "models:/tiny-lbp/1")
    where = {"MLFLOW_TRACKING_URI": f"sqlite:///{trained / 'mlflow.db'}"}
    with mlflow_serves(tmp_path, "/ping", *words, **where, MLFLOW_MODELS_WORKERS="1") as url:
        yield url


def asked(address, body=None):
    """Status and JSON of what a server answers."""
    request = urllib.request.Request(address, headers={"Content-Type": "application/json"})
    if body is not None:
        request.data = json.dumps(body).encode()
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            text, status = answer.read(), answer.status
    except urllib.error.HTTPError as error:
        text, status = error.read(), error.code
    return status, json.loads(text) if text.strip() else None


def test_the_server_answers_as_the_runtime_judges(served, frames, expected, tiny):
    assert asked(f"{served}/health")[0] == 200
    place, texts = f"{served}/invocations", list(map(as_text, frames))
    for body in (
        {"inputs": texts},
        {"inputs": {"frame": texts}},
        {"dataframe_records": [{"frame": text} for text in texts]},
        {"dataframe_split": {"columns": ["frame"], "data": [[text] for text in texts]}},
    ):
        status, answer = asked(place, body)
        assert status == 200, answer
        assert_same(answer["predictions"], expected)
    alone = {"inputs": texts, "params": {"independent": True}}
    assert_same(asked(place, alone)[1]["predictions"], expected)  # by this model's frame rule
    file = tiny.path / "Left" / "tiny_L_1.png"
    assert_same(asked(place, {"inputs": texts[0]})[1]["predictions"], expected[:1])
    for wrong in ([str(file)], ["/etc/resolv.conf"], ["no base64!"], [[1, 2], [3, 4]], 3, None):
        status, answer = asked(place, {"inputs": wrong})
        assert status == 400 and "tokt: " in answer["message"], answer
        assert "stack_trace" not in answer
    huge = cv2.imencode(".webp", np.zeros((10_001, 10_000), np.uint8))[1].tobytes()
    assert len(huge) < 100_000  # and is not decoded
    _, answer = asked(place, {"inputs": [base64.b64encode(huge).decode()]})
    assert "cannot be decoded (pixels <= CV_IO_MAX_IMAGE_PIXELS)" in str(answer)
    assert asked(place, {"inputs": texts[:1]})[0] == 200  # and goes on
    page = (ROOT / "docs" / "how-to" / "mlflow.md").read_text("utf-8")
    (shown,) = re.findall(r"```\nmlflow models serve.*?\n(.*?)```", page, re.DOTALL)
    command = shown.replace("http://localhost:5001", served).replace("frame.jpg", str(file))
    assert served in command and str(file) in command
    said = subprocess.run(["bash", "-c", command], capture_output=True, check=True).stdout
    assert_same(json.loads(said)["predictions"], expected[:1])
