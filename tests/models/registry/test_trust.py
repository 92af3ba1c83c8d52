"""Whoever can write a workspace: what tokt still reads of it, and what it refuses."""

import json
import os
import pickle
import shutil
import socket
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from tests.calls import call_tokt, refused, refuses, succeeds
from tests.fixtures import TRAIN_TINY
from tests.inference.test_faults import hold_row
from tests.models.parts import pack, unpack
from tokt.models.bundle.bundle import (
    bundle_bytes,
    bundle_from_bytes,
    read_bundle,
    weights_from_bytes,
)
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.registry import skops_arrays
from tokt.models.registry.registration import (
    FILES_TAG,
    NUMBER_TAG,
    SIGNATURE_TAG,
    RegisteredVersion,
    files_tag,
)
from tokt.models.registry.registry import BUNDLE_FILE, Registry
from tokt.models.registry.skops_arrays import pipeline_arrays

HERE = Path(__file__).parent
TRAIN = ("train", "tiny", "--extractor", "lbp", "--preset", "plain", *TRAIN_TINY)


def change(workspace, *statements):
    """Change a workspace's database as anybody who can write it could."""
    with closing(sqlite3.connect(workspace / "mlflow.db")) as database, database:
        for statement, *values in statements:
            database.execute(statement, values)


def run_folder(workspace, model="tiny-lbp"):
    """Where a model's files are."""
    run = Registry(workspace).find(model).run_id
    return workspace / "mlartifacts" / run / "artifacts" / "tokt"


def model_folder(workspace, model="tiny-lbp"):
    recipe = json.loads((run_folder(workspace, model) / "recipe.json").read_text("utf-8"))
    model_id = recipe["provenance"]["mlflow_model_id"]
    return workspace / "mlartifacts" / "models" / model_id / "artifacts"


def bundle_file(workspace, model="tiny-lbp"):
    return model_folder(workspace, model) / "data" / BUNDLE_FILE


def skops_file(workspace):
    """What version 0.1.0 kept of the weights of `tiny-lbp`."""
    return model_folder(workspace) / "model.skops"


def set_tag(workspace, key, value):
    update = "UPDATE model_version_tags SET value = ? WHERE key = ?"
    change(workspace, (update, value, key))


def edit_recipe(workspace, **edit):
    file = run_folder(workspace) / "recipe.json"
    file.write_text(json.dumps({**json.loads(file.read_text("utf-8")), **edit}), "utf-8")


def make_fit(workspace, model="tiny-lbp"):
    """Hash the files anew, as somebody does who knows of the tag."""
    found, folder = Registry(workspace).find(model), run_folder(workspace, model)
    names = json.loads(found.tags[FILES_TAG])["files"]
    places = {**{name: folder / name for name in names}, BUNDLE_FILE: bundle_file(workspace, model)}
    files = {name: places[name].read_bytes() for name in names}
    tag = files_tag(found.name, found.run_id, files)
    change(
        workspace,
        (
            "UPDATE model_version_tags SET value = ? WHERE key = ? AND name = ?",
            *(tag, FILES_TAG, found.name),
        ),
    )


def take_apart(workspace):
    """Leave `tiny-lbp` as it was logged before there were bundles: the members of the run."""
    members = unpack(bundle_file(workspace).read_bytes())
    for name in ("weights.npz", "golden.npz", "lineage.npz", "distribution.npz"):
        (run_folder(workspace) / name).write_bytes(members[name])
    bundle_file(workspace).unlink()
    edit_recipe(workspace, recipe_version=3)
    change(workspace, ("DELETE FROM model_version_tags WHERE key = ?", NUMBER_TAG))


@pytest.fixture
def old(workspace):
    """A workspace as version 0.1.0 wrote it: no hashes, and weights in a skops file alone."""
    take_apart(workspace)
    folder = run_folder(workspace)
    weights = weights_from_bytes((folder / "weights.npz").read_bytes(), "tiny-lbp")
    (folder / "weights.npz").unlink()
    mean, coef = np.zeros(weights["weights"].shape[1]), weights["weights"]
    arrays = {"coef_": coef, "intercept_": weights["bias"], "mean_": mean, "scale_": mean + 1}
    members = unpack((HERE / "model_of_0_1_0.skops").read_bytes())
    for name, file in skops_arrays._places(json.loads(members["schema.json"])).items():
        np.save(folder / "x.npy", arrays[name])
        members[file] = (folder / "x.npy").read_bytes()
    (folder / "x.npy").unlink()
    skops_file(workspace).write_bytes(pack(members))
    file = folder / "recipe.json"
    recipe = json.loads(file.read_text("utf-8"))
    del recipe["hashed"]
    file.write_text(json.dumps(recipe), "utf-8")
    change(workspace, ("DELETE FROM model_version_tags WHERE key = ?", FILES_TAG))
    return workspace


@pytest.fixture(scope="module")
def signed_pair(trained, key_files, tmp_path_factory):
    """A workspace with `tiny-lbp/1`, not signed, and `tiny-haralick/1`, signed by ``boat``."""
    workspace = tmp_path_factory.mktemp("pair") / ".tokt"
    shutil.copytree(trained, workspace)
    command = ("train", "tiny", "--extractor", "haralick", "--preset", "thesis", *TRAIN_TINY[:2])
    succeeds(*command, "--sign", key_files["boat"], "--workspace", workspace)
    return workspace


@pytest.fixture
def pair(signed_pair, tmp_path):
    """A copy of `signed_pair` that a test may change."""
    shutil.copytree(signed_pair, tmp_path / "pair")
    return tmp_path / "pair"


def export(workspace, model="tiny-lbp", *options):
    """Bytes of the exported bundle, and what was said on the way."""
    out = workspace.parent / "out.tokt"
    ran = succeeds("export", model, "-o", out, "--workspace", workspace, *options)
    return out.read_bytes(), ran.err


def export_refused(words, workspace, model="tiny-lbp", *options):
    out = workspace.parent / "never.tokt"
    refused(words, "export", model, "-o", out, "--workspace", workspace, *options)
    assert not out.exists()


class Payload:
    """What makes a folder when it is unpickled."""

    def __init__(self, place):
        self.place = str(place)

    def __reduce__(self):
        return os.mkdir, (self.place,)


def every_command(workspace, tiny, folder):
    """Call all that reads a registered model; how each ended."""
    where = ("--workspace", workspace)
    labelled = ("--mission", tiny.path, "--labels", tiny.labels)
    file = folder / "some.tokt"
    return {
        words[0]: call_tokt(*words, *where)
        for words in (
            ("export", "tiny-lbp", "-o", file),
            ("models", "show", "tiny-lbp"),
            ("evaluate", "tiny-lbp", *labelled),
            ("compare", "tiny-lbp", "tiny-haralick", *labelled, "-o", folder / "c.html"),
            ("deploy", "tiny-lbp", folder / "store"),
            ("labels", "audit", "tiny-lbp"),
            ("doctor",),
            ("label", tiny.path, "--model", "tiny-lbp", "--host", "no.invalid"),
        )
    }


@pytest.mark.parametrize("which", ["workspace", "old"])
def test_a_pickle_is_never_opened(which, request, tiny, tmp_path, tiny_bundle):
    place, marker = request.getfixturevalue(which), tmp_path / "ran"
    file = skops_file(place) if which == "old" else bundle_file(place)
    (model_folder(place) / "model.pkl").write_bytes(pickle.dumps(Payload(marker)))
    model = model_folder(place) / "MLmodel"
    text = model.read_text("utf-8").replace("data: data/model.tokt", "data: model.pkl")
    assert "model.pkl" in text
    model.write_text(text.replace("tokt.mlflow", "mlflow.sklearn"), "utf-8")
    ended = every_command(place, tiny, tmp_path)
    assert [ended[name].code for name in ("export", "models", "evaluate", "deploy")] == [0] * 4
    assert not marker.exists()
    assert (tmp_path / "some.tokt").read_bytes() == tiny_bundle.read_bytes()
    file.write_bytes(pickle.dumps(Payload(marker)))
    for name, ran in every_command(place, tiny, tmp_path).items():
        assert "Traceback" not in ran.err, name
    assert not marker.exists()
    hold_row(
        "a registered model whose `MLmodel` says pickle", "as without it: not opened", "nothing"
    )


def test_mlflow_may_forbid_pickles(workspace, tiny_bundle, monkeypatch):
    monkeypatch.setenv("MLFLOW_ALLOW_PICKLE_DESERIALIZATION", "false")
    assert export(workspace)[0] == tiny_bundle.read_bytes()
    hold_row("`MLFLOW_ALLOW_PICKLE_DESERIALIZATION=false`", "as without it", "nothing")


def test_a_version_of_before_there_were_bundles_gives_the_same_bundle(workspace, tiny_bundle):
    found, folder = Registry(workspace).find("tiny-lbp"), run_folder(workspace)
    take_apart(workspace)
    names = ("recipe.json", "weights.npz", "golden.npz", "lineage.npz", "distribution.npz")
    files = {name: (folder / name).read_bytes() for name in (*names, "held_out.parquet")}
    set_tag(workspace, FILES_TAG, files_tag("tiny-lbp", found.run_id, files))
    assert export(workspace) == (tiny_bundle.read_bytes(), "")
    for name in names:
        (folder / name).write_bytes(files[name] + b" ")
        export_refused(f"{name} is not the one that was registered", workspace)
        (folder / name).write_bytes(files[name])


def test_a_model_of_version_0_1_0_gives_the_same_bundle(old, tiny_bundle):
    data, said = export(old)
    assert data == tiny_bundle.read_bytes()
    assert "was registered by tokt 0.1.0, without hashes" in said


def test_a_recipe_of_version_1_is_read_and_one_of_tomorrow_is_not(old, tiny_bundle):
    registry, file = Registry(old), run_folder(old) / "recipe.json"
    recipe = json.loads(file.read_text("utf-8"))
    assert registry.bundle("tiny-lbp").distribution is not None
    newer = {"operating_point", "distribution", "sight"}
    first = {key: value for key, value in recipe.items() if key not in newer}
    file.write_text(json.dumps({**first, "recipe_version": 1}), "utf-8")
    bundle = registry.bundle("tiny-lbp")
    assert bundle.operating_point == OperatingPoint() and bundle.distribution is None
    assert bundle.sight == ()
    np.testing.assert_array_equal(bundle.model.weights, read_bundle(tiny_bundle).model.weights)
    for version in (0, 6, "2", None):
        edit_recipe(old, recipe_version=version)
        refuses("another generation of tokt", registry.bundle, "tiny-lbp")


def test_yesterdays_skops_file_is_read():
    found = pipeline_arrays((HERE / "model_of_0_1_0.skops").read_bytes(), "old")
    assert found["coef_"].shape == (1, 12) and found["mean_"].shape == found["scale_"].shape == (
        12,
    )
    firsts = [found[name].flat[0] for name in ("coef_", "intercept_", "mean_", "scale_")]
    wanted = [-0.78680317, -3.03393661, 0.15256368, 0.00919319]
    np.testing.assert_allclose(firsts, wanted, rtol=1e-5)


def test_a_skops_file_of_something_else_is_refused(old):
    """No class that it names is looked up, and no array of objects is opened."""
    file = skops_file(old)
    members = unpack(file.read_bytes())
    said = "nothing else is opened; train the model again, or use its .tokt file"
    for edit in (b'"Popen"', b'"StandardScaler"', b"[" * 100_000, b"", b"{}", b"null"):
        text = members["schema.json"].replace(b'"LinearSVC"', edit) if b'"' in edit else edit
        file.write_bytes(pack({**members, "schema.json": text}))
        export_refused(said, old)
    for array in (
        np.float64(1),
        np.array([{"a": 1}], object),
        np.zeros((1, 1 << 20)),
        np.zeros(12, "f4"),
    ):
        np.save(old / "x.npy", array, allow_pickle=True)
        data = (old / "x.npy").read_bytes()
        others = {name: data for name in members if name.endswith(".npy")}
        file.write_bytes(pack({**members, **others}))
        export_refused("tiny-lbp/1", old)
    file.write_bytes(b"PK")
    export_refused("truncated or damaged", old)
    hold_row(
        "a registered model of 0.1.0 that is no scaler and LinearSVC",
        "refused: `nothing else is opened`",
        "nothing",
    )


def test_a_recipe_that_is_none_or_has_other_values_is_one_line(old):
    file = run_folder(old) / "recipe.json"
    whole = file.read_bytes()
    for text in ("{", "null", '{"recipe_version": 3, "distribution": null}'):
        file.write_text(text, "utf-8")
        export_refused("its recipe.json", old)
    for edit in (
        {"thresholds": [1e309]},
        {"classes": 5},
        {"operating_point": {}},
        {"provenance": {"mlflow_model_id": "../../../somewhere"}},
        {"metrics": None},
    ):
        file.write_bytes(whole)
        edit_recipe(old, **edit)
        export_refused("tiny-lbp/1", old)
    hold_row("a registered model whose recipe is damaged", "refused: `its recipe.json`", "nothing")


def test_an_edited_file_is_not_what_was_registered(workspace):
    folder = run_folder(workspace)
    for file in (bundle_file(workspace), folder / "recipe.json"):
        before = file.read_bytes()
        file.write_bytes(before + b" ")
        export_refused(f"{file.name} is not the one that was registered", workspace)
        file.write_bytes(before)
    table = folder / "held_out.parquet"
    table.write_bytes(table.read_bytes() + b" ")
    refuses("held_out.parquet is not the one", Registry(workspace).held_out, "tiny-lbp")
    doctor = json.loads(call_tokt("doctor", "--json", "--workspace", workspace).out)
    states = {found["name"]: (found["state"], found["text"]) for found in doctor["findings"]}
    words = "model tiny-lbp/1: held_out.parquet is not the one that was registered"
    assert states["registry"] == ("fault", words)
    said = "refused: `is not the one that was registered`"
    hold_row("a file of a registered model edited", said, "nothing")


def test_a_registration_of_format_1_is_read(keys):
    """As it stands in the tags of registered versions, and what a key signed of it."""
    tag = (
        '{"files":{"a.npz":"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"},'
        '"format_version":1,"name":"m","run_id":"r1"}'
    )
    assert files_tag("m", "r1", {"a.npz": b"abc"}) == tag
    found = RegisteredVersion("m", "7", (), "r1", {FILES_TAG: tag})
    found.check("a.npz", b"abc")
    refuses("a.npz is not the one", found.check, "a.npz", b"abd")
    refuses("b.npz is not the one", found.check, "b.npz", b"abc")
    boat, message = keys["boat"], b"tokt registration, signature format 1\nm/7\n" + tag.encode()
    signature = boat.signature(message).to_bytes().decode()
    assert found.signature(boat) == signature
    signed = replace(found, tags={**found.tags, SIGNATURE_TAG: signature})
    assert signed.check_signature(boat.public) and not found.check_signature(boat.public)
    refuses("does not fit", replace(signed, version="8").check_signature, boat.public)


def test_hashes_that_are_gone_or_damaged(workspace):
    for value in ("", "[]", '{"format_version": 1, "files": {"recipe.json": 5}}'):
        set_tag(workspace, FILES_TAG, value)
        export_refused("tokt.files is damaged", workspace)
    set_tag(workspace, FILES_TAG, '{"format_version": 2, "files": {}}')
    export_refused("registered by another generation of tokt", workspace)
    change(workspace, ("DELETE FROM model_version_tags WHERE key = ?", FILES_TAG))
    export_refused("the hashes of its files are gone", workspace)
    hold_row("the hashes of a registered model taken away", "refused: `are gone`", "nothing")


def test_runs_exchanged_between_models(pair):
    """In the database: each name then leads to the other's files."""
    runs = [Registry(pair).find(name).run_id for name in ("tiny-lbp", "tiny-haralick")]
    update = "UPDATE model_versions SET run_id = ? WHERE name = ?"
    change(pair, (update, runs[1], "tiny-lbp"), (update, runs[0], "tiny-haralick"))
    for name in ("tiny-lbp", "tiny-haralick"):
        export_refused("its files were registered as", pair, name)
    tags = "UPDATE model_version_tags SET name = ? WHERE key = ? AND name = ?"
    moved = [("x", "tiny-lbp"), ("tiny-lbp", "tiny-haralick"), ("tiny-haralick", "x")]
    change(pair, ("PRAGMA foreign_keys = OFF",), *((tags, to, FILES_TAG, of) for to, of in moved))
    export_refused("its files were registered as 'tiny-haralick'", pair)
    said = "refused: `its files were registered as`"
    hold_row("the runs of two registered models exchanged", said, "nothing")


def test_a_signed_registration_is_checked_by_who_exports(pair, key_files):
    boat, other = key_files["boat"], key_files["other"]
    public = boat.with_suffix(".pub")
    _, said = export(pair, "tiny-haralick", "--sign", boat, "--registered-by", public)
    assert said == ""
    export_refused("is signed by key", pair, "tiny-haralick", "--sign", other)
    file = run_folder(pair, "tiny-haralick") / "recipe.json"
    recipe = json.loads(file.read_text("utf-8"))
    recipe["metrics"]["patch"]["f1"] = 1.0
    file.write_text(json.dumps(recipe), "utf-8")
    make_fit(pair, "tiny-haralick")
    export(pair, "tiny-haralick")  # hashes protect from accident alone
    for options in (("--sign", boat), ("--registered-by", public)):
        export_refused("its signature does not fit", pair, "tiny-haralick", *options)
    said = "refused by who gives the key: `its signature does not fit`"
    hold_row("a signed registration edited, with hashes made to fit", said, "nothing")


def test_a_signature_of_another_version_does_not_fit(pair, key_files):
    """Its name and number are signed: not even the same model's other version has it."""
    registry = Registry(pair)
    found = registry.find("tiny-haralick")
    model_id = registry.recipe(found)["provenance"]["mlflow_model_id"]
    what = ("tiny-haralick", f"models:/{model_id}", found.run_id, model_id)
    again = registry.register(*what, found.tags)
    assert again.version == "2" and again.tags == found.tags
    export_refused("has no version 2", pair, "tiny-haralick/2")  # its number is another one
    without = {key: value for key, value in found.tags.items() if key != NUMBER_TAG}
    assert registry.register(*what, without).version == "3"
    export_refused("its bundle is of tiny-haralick/1", pair, "tiny-haralick/3")
    boat = key_files["boat"]
    export_refused("its signature does not fit", pair, "tiny-haralick/3", "--sign", boat)
    export(pair, "tiny-haralick/1", "--sign", boat)


def test_a_signature_that_is_gone(pair, key_files):
    change(pair, ("DELETE FROM model_version_tags WHERE key = ?", SIGNATURE_TAG))
    boat = key_files["boat"]
    _, said = export(pair, "tiny-haralick", "--sign", boat)
    assert "WARNING: the registration of model tiny-haralick/1 is not signed" in said
    by = ("--registered-by", boat.with_suffix(".pub"))
    export_refused("is not signed", pair, "tiny-haralick", *by)
    refused("is not signed", "deploy", "tiny-haralick", pair / "s", *by, "--workspace", pair)
    refused("not with a file", "deploy", "some.tokt", pair / "s", *by, "--workspace", pair)
    said = "warned of under `--sign`, refused under `--registered-by`"
    hold_row("the signature of a registration taken away", said, "nothing")


@pytest.mark.parametrize(
    ("value", "words"),
    [("{}", "signature is"), ('{"format_version": 9}', "signature has format 9, newer than")],
)
def test_a_signature_that_is_none(pair, key_files, value, words):
    set_tag(pair, SIGNATURE_TAG, value)
    export_refused(words, pair, "tiny-haralick", "--sign", key_files["boat"])


def test_parameters_of_a_run_that_do_not_fit(pair):
    """They stand in the database, without hashes."""
    words, where = "model tiny-lbp/1: its list of parameters does not fit", ("--workspace", pair)
    compare = ("compare", "tiny-lbp", "tiny-haralick", "-o", pair / "c.html", *where)
    audit = ("labels", "audit", "tiny-lbp", *where)
    change(pair, ("CREATE TABLE before AS SELECT * FROM params",))
    for name, values, commands in (
        ("split_folds", ("9" * 5000,), (audit,)),
        ("split_embargo_frames", ("-1",), (audit,)),
        ("split_by", ("frame",), (compare,)),
        ("split_weight", ("",), (audit,)),
        ("split_sites", ("{", "-" * 100_000 + "1"), (audit,)),
        ("setting_scale", ("nothing(", "\0"), (compare,)),
        ("setting_changes", ("(5,)",), (compare,)),
    ):
        for value in values:
            change(pair, ("UPDATE params SET value = ? WHERE key = ?", value, name))
            for command in commands:
                refused(words, *command)
        change(pair, ("DELETE FROM params",), ("INSERT INTO params SELECT * FROM before",))
    change(pair, ("DELETE FROM params",))
    refused(words, *compare)
    refused(words, *audit)
    said = "refused: `its list of parameters does not fit`"
    hold_row("the logged parameters of a registered model edited", said, "nothing")


def test_a_table_of_held_out_patches_that_does_not_fit(old):
    file, registry = run_folder(old) / "held_out.parquet", Registry(old)
    table, before = parquet.read_table(file), registry.held_out("tiny-lbp")
    for notes in (b"5", b"[]", b"{}", b'{"index_columns": ["x"], "columns": []}'):
        parquet.write_table(table.replace_schema_metadata({b"pandas": notes}), file)
        assert registry.held_out("tiny-lbp").equals(before)
    value = table.column_names.index("value_0")
    texts = pa.array(["a"] * len(table))
    for other in (table.drop_columns(["frame"]), table.set_column(value, "value_0", texts)):
        parquet.write_table(other, file)
        refused("not what training writes", "labels", "audit", "tiny-lbp", "--workspace", old)


def test_names_in_the_database_move_no_cursor(workspace):
    for table in ("registered_models", "model_versions", "model_version_tags"):
        change(
            workspace, ("PRAGMA foreign_keys = OFF",), (f"UPDATE {table} SET name = ?", "\x1b[2J")
        )
    update = "UPDATE model_version_tags SET value = ? WHERE key != ?"
    change(workspace, (update, "\x9b1A\u202e", NUMBER_TAG))
    listed = succeeds("models", "list", "--workspace", workspace).out
    assert listed.startswith(r"\x1b[2J/1") and listed.replace("\n", "").isprintable()
    assert r"\x9b1A\u202e on" in listed


SILENT = OperatingPoint(MofNRule(margin=1e6))


def test_a_model_that_never_warns_is_not_exported(workspace):
    content = Registry(workspace).bundle("tiny-lbp").content
    said = "model tiny-lbp/1 is not shipped: it warns of no golden frame with obstacle patches"
    for point in (SILENT, OperatingPoint(MofNRule(0.0, 100))):
        file = bundle_file(workspace)
        file.write_bytes(bundle_bytes(replace(content, operating_point=point)))
        export_refused("model.tokt is not the one that was registered", workspace)
        make_fit(workspace)
        export_refused(said, workspace)


def test_a_bundle_that_never_warns_guards_no_vehicle(tiny_bundle, tiny, tmp_path):
    honest = read_bundle(tiny_bundle)
    assert honest.deployment_fault == ""
    file = tmp_path / "silent.tokt"
    file.write_bytes(bundle_bytes(replace(honest.content, operating_point=SILENT)))
    assert "warns of no golden frame" in read_bundle(file).deployment_fault  # and yet it loads
    words = "it warns of no golden frame with obstacle patches"
    refused(words, "deploy", file, tmp_path / "store")
    refused(words, "export", file, "-o", tmp_path / "again.tokt")
    refused(words, "run", "--bundle", file, "--source", tiny.path, "--policy", "texture")
    said = "refused: `it warns of no golden frame with obstacle patches`"
    hold_row("an operating point that no golden frame reaches: a margin of 1e6", said, "nothing")


def test_thresholds_that_nothing_reaches_are_told(tiny_bundle, tmp_path):
    """Also where the golden verdicts are made to fit."""
    content = read_bundle(tiny_bundle).content
    golden = replace(content.golden, obstacle=np.zeros_like(content.golden.obstacle))
    model = replace(content.model, thresholds=np.array([1e6]))
    file = tmp_path / "deaf.tokt"
    file.write_bytes(bundle_bytes(replace(content, golden=golden, model=model)))
    words = "WARNING: tiny-lbp/1 sees no obstacle in its golden frames"
    assert words in succeeds("export", file, "-o", tmp_path / "again.tokt").err
    assert words in succeeds("deploy", file, tmp_path / "store").err
    said = "warned of at export and deployment: it may be a weak model"
    hold_row("patch thresholds that no golden frame reaches", said, "nothing")


def test_a_rule_over_frames_is_held_to_a_frame_that_stays(tiny_bundle):
    honest = read_bundle(tiny_bundle)
    for rule, silent in (
        (MofNRule(0.0, 1, 60, 60), False),
        (MofNRule(1.0, 6, 3, 5), False),
        (MofNRule(1.0, 8, 3, 5), True),
        (MofNRule(3.0, 8, 3, 5, 3.3), False),  # one patch is enough at once
        (MofNRule(3.0, 8, 3, 5, 1e9), True),
    ):
        content = replace(honest.content, operating_point=OperatingPoint(rule))
        assert bool(bundle_from_bytes(bundle_bytes(content), "x").silence) == silent


def test_a_moved_workspace_is_whole(workspace, tiny_bundle, tmp_path):
    moved = workspace.rename(tmp_path / "elsewhere")
    assert export(moved)[0] == tiny_bundle.read_bytes()
    assert not workspace.exists()
    hold_row("a workspace that was moved", "as without it", "nothing")


def test_a_copied_workspace_reads_and_writes_its_own(workspace, trained, tiny_bundle, tmp_path):
    """Under a name that an address has to escape."""
    copy = tmp_path / "50% copy æøå #1"
    shutil.copytree(workspace, copy)
    (run_folder(workspace) / "recipe.json").write_text("{}", "utf-8")
    assert export(copy)[0] == tiny_bundle.read_bytes()
    export_refused("recipe.json", workspace)
    before = sorted((workspace / "mlartifacts").rglob("*"))
    succeeds(*TRAIN, "--workspace", copy)
    assert sorted((workspace / "mlartifacts").rglob("*")) == before
    with closing(sqlite3.connect(copy / "mlflow.db")) as database:
        query = (
            "SELECT artifact_uri FROM runs UNION ALL SELECT artifact_location FROM logged_models "
            "UNION ALL SELECT storage_location FROM model_versions"
        )
        places = [place for (place,) in database.execute(query)]
    # MLflow's own tools find its files too, also those of before.
    assert len(places) == 6 and all(place.startswith(f"{copy.as_uri()}/") for place in places)
    shutil.rmtree(run_folder(copy, "tiny-lbp/1"))
    export_refused("missing from its run", copy, "tiny-lbp/1")  # not taken from another workspace
    hold_row("a workspace that was copied, and the original changed", "as without it", "nothing")


def test_a_database_behind_a_link_keeps_its_own_files(workspace, tiny_bundle, tmp_path):
    """It is the other workspace's, artifacts and all: none of its places is changed."""
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "mlflow.db").symlink_to(workspace / "mlflow.db")
    (linked / "datasets").symlink_to(workspace / "datasets")
    export(workspace)
    succeeds(*TRAIN, "--workspace", linked)
    assert not (linked / "mlartifacts").exists()
    for place in (linked, workspace):
        assert export(place, "tiny-lbp/1")[0] == tiny_bundle.read_bytes()
        export(place, "tiny-lbp/2")


def test_places_in_the_database_are_not_read(workspace, tiny_bundle, tmp_path):
    """Neither another folder nor an address; nobody is asked."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        for place in (
            f"http://127.0.0.1:{server.getsockname()[1]}/x",
            "s3://somewhere/x",
            tmp_path.as_uri(),
            "../../x",
        ):
            change(
                workspace,
                ("UPDATE runs SET artifact_uri = ?", place),
                ("UPDATE logged_models SET artifact_location = ?", place),
                ("UPDATE model_versions SET source = ?, storage_location = ?", place, place),
            )
            assert export(workspace)[0] == tiny_bundle.read_bytes()
        with pytest.raises(BlockingIOError):
            server.accept()
    said = "as without it: not read, nobody is asked"
    hold_row("artifact URIs exchanged in `mlflow.db`, also for addresses", said, "nothing")


@pytest.mark.parametrize("depth", [0, 1, 2])
def test_a_link_out_of_the_workspace_is_refused(workspace, tmp_path, depth):
    """Even to the very same bytes: what it leads to can be exchanged."""
    place = run_folder(workspace) / "recipe.json"
    place = (place, *place.parents)[depth]
    place.rename(tmp_path / "outside")
    place.symlink_to(tmp_path / "outside")
    export_refused("is not in the workspace itself", workspace)
    hold_row(
        "a link out of the workspace in an artifact folder",
        "refused: `is not in the workspace itself`",
        "nothing",
    )


def test_a_run_that_names_another_folder_is_refused(workspace, tmp_path):
    outside = workspace / "mlartifacts" / Registry(workspace).find("tiny-lbp").run_id
    shutil.copytree(outside, tmp_path / "outside")
    for run in ("../../outside", str(tmp_path / "outside"), "\0", "x" * 5000):
        change(workspace, ("UPDATE model_versions SET run_id = ?", run))
        export_refused("tiny-lbp/1: recipe.json", workspace)
    said = "refused: `is not in the workspace itself`"
    hold_row("a run id that leads out of the workspace", said, "nothing")


def test_a_file_that_never_ends_is_refused(workspace):
    file = run_folder(workspace) / "recipe.json"
    with file.open("wb") as handle:
        handle.truncate(1 << 40)
    export_refused("is far too large", workspace)
    file.unlink()
    os.mkfifo(file)  # reading it would wait for ever
    export_refused("missing from its run", workspace)
    file.unlink()
    file.symlink_to(file)
    export_refused("recipe.json", workspace)
    said = "refused: `is far too large`, `is missing`"
    hold_row("an artifact of 10^12 bytes, or a pipe", said, "nothing")


def test_a_table_that_says_it_is_huge_is_refused(workspace, monkeypatch):
    file = run_folder(workspace) / "held_out.parquet"
    rows = pa.repeat(pa.scalar(0, pa.int8()), 1_000_000)
    parquet.write_table(pa.table({"a": rows, "b": rows}), file)
    assert file.stat().st_size < 20_000
    make_fit(workspace)
    refuses("is not what training writes", Registry(workspace).held_out, "tiny-lbp")
    monkeypatch.setattr("tokt.models.registry.registry._MAX_TABLE_VALUES", 1_999_999)
    refuses("is far too large", Registry(workspace).held_out, "tiny-lbp")
    for data in (b"", b"PAR1" * 10):
        file.write_bytes(data)
        make_fit(workspace)
        refuses("held_out.parquet", Registry(workspace).held_out, "tiny-lbp")
    said = "refused: `is far too large`"
    hold_row("a table of held-out patches that unpacks to more than memory", said, "nothing")
