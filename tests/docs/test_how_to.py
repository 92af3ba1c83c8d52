"""The snippets of the how-to pages do what is said of them."""

import re
from pathlib import Path

import pytest

import tokt
from tests.calls import refused, succeeds

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


def test_pictures_without_numbers_get_some(tiny, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("pictures").mkdir()
    for name, frame in (("crab one", 3), ("tower", 30)):
        picture = tiny.path / f"Left/tiny_L_{frame}.png"
        Path(f"pictures/{name}.png").write_bytes(picture.read_bytes())
    run = ("run", "--model", "waters", "--source")
    (words,) = re.findall(r"refused: \*(.*)\*", (HOW_TO / "numbers.md").read_text("utf-8"))
    refused(f"crab one.png: {words}", *run, "pictures")
    (code,) = snippets("numbers.md")
    exec(code, {})
    assert [*map(str, sorted(Path("numbered").iterdir()))] == [
        "numbered/crab one_0001.png",
        "numbered/tower_0002.png",
    ]
    assert "2 frames" in succeeds(*run, "numbered").err + succeeds(*run, "numbered").out
    with pytest.raises(FileExistsError):
        exec(code, {})
