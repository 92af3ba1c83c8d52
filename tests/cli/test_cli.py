"""The command line as a whole: its version, and what it can do and say aboard without MLflow."""

import json
import re
from pathlib import Path

import pytest

import tokt
from tests.calls import succeeds
from tokt.models.bundle.bundle import read_bundle
from tokt.models.store.store import Store

TRAINING_TOOLS = ("mlflow", "pandas", "sklearn", "joblib", "matplotlib", "pyarrow")


def test_version(run_tokt):
    ran = run_tokt("--version")
    assert (ran.code, ran.out, ran.err) == (0, f"tokt {tokt.__version__}\n", "")


def test_a_bundle_file_is_shown_without_mlflow(tiny_bundle, tmp_path, tokt_without):
    card = tokt_without(TRAINING_TOOLS, tmp_path, "models", "show", tiny_bundle)
    assert (card.returncode, card.stderr) == (0, "")
    assert card.stdout == read_bundle(tiny_bundle).content.card
    named = tokt_without(TRAINING_TOOLS, tmp_path, "models", "show", "tiny-lbp")
    assert named.returncode == 2 and "extra 'train'" in named.stderr


def test_the_store_says_where_its_model_comes_from(tiny_bundle, tmp_path, tokt_without):
    bundle = read_bundle(tiny_bundle)
    Store(tmp_path / "store").deploy(bundle, "sea trial")
    provenance = bundle.content.provenance
    ran = tokt_without(TRAINING_TOOLS, tmp_path, "store", "store")
    assert (ran.returncode, ran.stderr) == (0, "")
    lines = ran.stdout.splitlines()
    assert lines[0] == "active: tiny-lbp/1"
    assert f"  dataset: {provenance['dataset']}" in lines
    assert f"  dataset hash: {provenance['dataset_hash']}" in lines
    assert f"  missions and labels: {provenance['dataset_sources']}" in lines
    assert f"  MLflow run: {provenance['mlflow_run_id']}" in lines
    assert f"  code version: {provenance['code_version']}" in lines
    assert "mission tiny; labels by labels (" in ran.stdout
    assert lines[-1].endswith("sea trial")
    ran = tokt_without(TRAINING_TOOLS, tmp_path, "store", "store", "--json")
    found = json.loads(ran.stdout)
    assert found["provenance"] == provenance and found["warnings"] == []


@pytest.mark.parametrize("damaged", ["bundle", "active", "history.jsonl"])
def test_a_damaged_store_shows_what_is_left(damaged, tiny_bundle, tmp_path, run_tokt):
    store = Store(tmp_path / "store")
    for _ in range(2):
        entry = store.deploy(read_bundle(tiny_bundle))
    file = store.path / damaged
    if damaged == "bundle":
        file = store.path / "versions" / entry.sha256 / "bundle.tokt"
    file.write_bytes(b"?" + file.read_bytes()[1:])
    ran = run_tokt("store", store.path)
    assert ran.code == 0
    assert ran.err.startswith("WARNING: ") and ran.err.count("\n") == 1
    shown = [line.split()[0] for line in ran.out.splitlines() if "  deploy  " in line]
    assert shown == (["2"] if damaged == "history.jsonl" else ["1", "2"])
    first = ran.out.splitlines()[0]
    assert first == f"active: {'not known' if damaged == 'active' else 'tiny-lbp/1'}"
    found = json.loads(run_tokt("store", store.path, "--json").out)
    assert len(found["warnings"]) == 1

    mended = run_tokt("deploy", tiny_bundle, store.path, "--json")
    assert mended.code == 0 and json.loads(mended.out)["number"] == 3
    assert ("was damaged; it is kept as" in mended.err) == (damaged != "bundle")
    again = run_tokt("store", store.path)
    assert (again.code, again.err) == (0, "")


@pytest.mark.parametrize("command", ["store", "rollback"])
def test_a_store_that_is_not_there(command, tmp_path, run_tokt):
    ran = run_tokt(command, tmp_path / "none")
    assert (ran.code, ran.out) == (2, "")
    assert ran.err == f"tokt: error: store {tmp_path / 'none'} does not exist\n"
    assert not (tmp_path / "none").exists()


def test_alias_as_json(workspace):
    command = ("models", "alias", "tiny-lbp", "champion", "--workspace", workspace, "--json")
    found = json.loads(succeeds(*command).out)
    assert (found["name"], found["version"]) == ("tiny-lbp", "1")
    assert "champion" in found["aliases"]


@pytest.mark.parametrize(
    "command", ["labels import x.csv", "labels stats", "dataset list", "models list", "store x"]
)
def test_commands_share_their_options(command, run_tokt):
    helped = run_tokt(*command.split(), "--help").out
    options = {
        name: " ".join(re.findall(rf"{name}\b.*?(?=\n +-|\Z)", helped, re.S)[:1]).split()
        for name in ("--workspace", "--json")
        if name in helped
    }
    assert " ".join(options["--json"]) == "--json Print one JSON object."
    if "--workspace" in options:
        expected = "--workspace DIR Folder that holds tokt's state. [default: .tokt]"
        assert " ".join(options["--workspace"]) == expected


def test_every_command_prints_what_a_terminal_shows_as_it_is():
    """By `print_line`; a datagram's line and `--print-config` are made printable by themselves."""
    for file in (Path(tokt.__file__).parent / "cli").glob("*.py"):
        text = file.read_text()
        if file.name not in ("app.py", "output.py", "run.py") and re.search(r"\bprint\(", text):
            assert "from .output import print_line as print\n" in text, file
        assert file.name == "app.py" or "typer.echo(" not in text, file
