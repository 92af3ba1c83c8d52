"""The command line as a whole: its version, and what it can do and say aboard without MLflow."""

import json
import re
from pathlib import Path

import tokt
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


def test_every_command_prints_what_a_terminal_shows_as_it_is():
    """By `print_line`; a datagram's line and `--print-config` are made printable by themselves."""
    for file in (Path(tokt.__file__).parent / "cli").glob("*.py"):
        text = file.read_text()
        if file.name not in ("app.py", "output.py", "run.py") and re.search(r"\bprint\(", text):
            assert "from .output import print_line as print\n" in text, file
        assert file.name == "app.py" or "typer.echo(" not in text, file
