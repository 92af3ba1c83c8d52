"""The snippets of the how-to pages do what is said of them."""

import json
import re
from pathlib import Path

import tokt
from tests.calls import succeeds

HOW_TO = Path(__file__).resolve().parents[2] / "docs" / "how-to"


def snippets(page):
    return re.findall(r"```python\n(.*?)```", (HOW_TO / page).read_text("utf-8"), re.DOTALL)


def test_python_judges_a_file_and_a_folder_and_trains(own_tiny, tmp_path, monkeypatch, capsys):
    own_tiny.path.rename(tmp_path / "dive")
    labels = tmp_path / "dive/labels.csv"
    labels.write_text(labels.read_text().replace("tiny,", "dive,"))
    (tmp_path / "dive/Left/tiny_L_17.png").rename(tmp_path / "dive/Left/sim_L_17.jpg")
    monkeypatch.chdir(tmp_path)
    found = {}
    for code in snippets("python.md"):
        # for time
        code = code.replace('name="tower"', 'name="tower", preset="plain", jobs=1')
        exec(code, found)
    assert len(found["statuses"]) == 40 and found["own"].label == "tower/1"
    assert tokt.load_model("tower.tokt").sha256 == found["own"].sha256
    assert found["version"].metrics["patch"]["f1"] > 0.9
    assert len(capsys.readouterr().out.splitlines()) >= 42


def test_pictures_without_numbers_get_some(tiny, tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name, frame in (("crab one", 3), ("tower", 30)):
        picture = tiny.path / f"Left/tiny_L_{frame}.png"
        (pictures / f"{name}.png").write_bytes(picture.read_bytes())
    ran = succeeds("run", "--model", "waters", "--source", pictures)
    assert "2 frames" in ran.err + ran.out
    (record,) = re.findall(r"`(tokt_\w+.json)`", (HOW_TO / "numbers.md").read_text("utf-8"))[:1]
    numbers = json.loads((pictures / record).read_text("utf-8"))["numbers"]
    assert numbers == {"left": {"crab one.png": 1, "tower.png": 2}}
