"""The plain install, without [train], judges frames with a bundle made by the full one."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.process.installed import fresh_python
from tokt.features.frames.mission import open_mission
from tokt.features.kernels.dispatch import KERNELS

ROOT = Path(__file__).resolve().parents[2]
TRAINING_TOOLS = (
    *("mlflow", "pandas", "sklearn", "skimage", "mahotas", "scipy", "joblib"),
    *("matplotlib", "pyarrow", "fastapi", "jinja2", "pydantic"),
)


def _run(*command):
    # Not from the checkout: its folder `tokt` would stand before the installed package.
    words, folder = [str(part) for part in command], tempfile.gettempdir()
    return subprocess.run(words, capture_output=True, text=True, check=False, cwd=folder)


def _judged(python, bundle, mission, log):
    about = ("--bundle", bundle, "--source", mission, "--log", log, "--log-values")
    done = _run(python, "-m", "tokt", "run", *about, "--format", "v2")
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in log.read_text().splitlines()]


@pytest.fixture(scope="module")
def slim_python(wheel, tmp_path_factory):
    home = tmp_path_factory.mktemp("slim") / "venv"
    return fresh_python(home, wheel, "-c", ROOT / "constraints.txt")


def test_plain_install_runs_a_bundle(slim_python, workspace, tiny, tiny_bundle, tmp_path):
    find = f"print([n for n in {TRAINING_TOOLS!r} if importlib.util.find_spec(n)])"
    assert _run(slim_python, "-c", f"import importlib.util; {find}").stdout == "[]\n"

    mission, bundle, space = tiny.path, tiny_bundle, ("--workspace", workspace)
    lines = _judged(slim_python, bundle, mission, tmp_path / "log.jsonl")
    assert [line["frame"] for line in lines] == open_mission(mission).frames()
    assert {line["status"] for line in lines} == {0, 1}

    full = _judged(sys.executable, bundle, mission, tmp_path / "full.jsonl")
    assert [x["decision_values"] for x in lines] == [x["decision_values"] for x in full]

    # The runtime's pieces, by their public names.
    pieces = f"""
import tokt
policy = tokt.SinglePolicy(tokt.TextureDetector(tokt.load_model({str(bundle)!r})))
print([policy.judge(frame).verdict.status for frame in tokt.open_source({str(mission)!r})])
"""
    said = _run(slim_python, "-c", pieces)
    assert said.stdout == f"{[line['status'] for line in lines]}\n", said.stderr

    for words, said in (
        (("train", "tiny", "--extractor", "lbp", *space), "extra 'train'"),
        (("evaluate", "tiny-lbp", "--mission", mission, *space), "extra 'train'"),
        (("demo", "--help"), "tokt demo comes with the distribution tokt-studies"),
        (("bench", "--help"), "tokt bench comes with the distribution tokt-studies"),
        (("simulate", "--help"), "tokt simulate comes with the distribution tokt-studies"),
    ):
        refused = _run(slim_python, "-m", "tokt", *words)
        assert refused.returncode == 2 and refused.stderr.count("\n") == 1, refused.stderr
        assert said in refused.stderr
    refused = _run(slim_python, "-c", "import tokt; tokt.simulate_mission")
    assert "tokt.simulate_mission needs tokt_studies: install the distribution" in refused.stderr

    found = _run(slim_python, "-m", "tokt", "doctor", "--json", *space)
    findings = {item["name"]: item for item in json.loads(found.stdout)["findings"]}
    assert found.returncode == 0, found.stdout
    assert findings["kernels"]["kernels"] == KERNELS.name
    assert findings["library kernels"]["state"] == "note"
