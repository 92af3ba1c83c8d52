"""`tokt doctor --support`: what a colleague needs, whatever is broken, and no secrets."""

import json
import tomllib
import zipfile

import pytest

from tests.calls import call_tokt
from tokt.models.bundle.bundle import read_bundle
from tokt.models.store.store import Store

SECRET = "s3cr3t"
CONFIG = """
[source]
source = "rtsp://pilot:{secret}@10.0.0.9:8554/main?password={secret}"
[model]
store = "{folder}/store"
[recording]
log = "{folder}/dive.jsonl"
record = "{folder}/rec"
"""


@pytest.fixture
def ship(tiny_bundle, tmp_path, monkeypatch):
    """A ship's folder, with a secret wherever one may lie."""
    Store(tmp_path / "store").deploy(read_bundle(tiny_bundle))
    (tmp_path / "store" / "boat.key").write_text(SECRET)
    (tmp_path / ".tokt").mkdir()
    (tmp_path / ".tokt" / "token").write_text(SECRET)
    (tmp_path / "dive.toml").write_text(CONFIG.format(secret=SECRET, folder=tmp_path))
    line = json.dumps({"frame": 1, "left": f"rtsp://pilot:{SECRET}@10.0.0.9/main"}) + "\n"
    (tmp_path / "dive.jsonl").write_text(line * 20 + '{"frame": 2}\n')
    (tmp_path / "dive.events.jsonl").write_text('{"event": "start"}\n')
    (tmp_path / "rec" / "run").mkdir(parents=True)
    (tmp_path / "rec" / "run" / "left_1.png").write_bytes(b"picture")
    traces = tmp_path / "tmp"
    traces.mkdir()
    (traces / "tokt-traceback-1.txt").write_text(
        f"Error: http://me:{SECRET}@host/\nPASSWORD={SECRET}\nAuthorization: Bearer {SECRET}\n"
    )
    monkeypatch.setattr("tempfile.tempdir", str(traces))
    for name in ("TOKT_KEY_PASSPHRASE", "TOKT_SOURCE_PASSWORD", "MLFLOW_TRACKING_PASSWORD"):
        monkeypatch.setenv(name, SECRET)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def packed(folder, *options):
    done = call_tokt("doctor", "--support", folder / "help.zip", *options)
    with zipfile.ZipFile(folder / "help.zip") as archive:
        return done, {name: archive.read(name).decode() for name in archive.namelist()}


def test_it_holds_what_a_colleague_needs_and_no_secret(ship):
    first, *_, last = (ship / "dive.jsonl").read_text().splitlines(keepends=True)
    (ship / "dive.jsonl").write_text(first * 20_000 + last)
    done, parts = packed(ship, "--config", "dive.toml")
    names = {"doctor.json", "machine.json", "packages.txt", "config.toml", "store.json"}
    logs = {"logs/dive.jsonl", "logs/dive.events.jsonl"}
    assert parts.keys() == names | logs | {"tracebacks/tokt-traceback-1.txt", "not_read.txt"}
    assert all(name in done.err for name in parts)
    assert "left out: keys, tokens, passwords in addresses, frames\n" in done.err
    assert SECRET not in "".join(parts.values()) and SECRET not in done.err
    assert "rtsp://10.0.0.9:8554/main" in parts["config.toml"]
    assert len(json.loads(parts["store.json"])["history"]) == 1
    lines = parts["logs/dive.jsonl"].splitlines()  # the end of it, in whole lines
    assert 1000 < len(lines) < 20_000 and json.loads(lines[-1]) == {"frame": 2}
    assert json.loads(lines[0]) == {"frame": 1, "left": "rtsp://10.0.0.9/main"}
    assert "numpy==" in parts["packages.txt"] and parts["not_read.txt"] == ""


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ("dive.toml", "config dive.toml: "),
        ("store/history.jsonl", "store"),
        ("dive.jsonl", "logs/dive.jsonl: "),
    ],
)
def test_what_is_broken_is_said_and_the_rest_is_there(ship, broken, said):
    (ship / broken).unlink()
    (ship / broken).mkdir()
    done, parts = packed(ship, "--config", "dive.toml")
    assert "machine.json" in parts and "doctor.json" in parts
    assert said in parts["not_read.txt"] + parts["doctor.json"] + parts.get("store.json", "")
    assert "Traceback" not in done.err


LINES = [
    {"left": "http://10.0.0.9:8554/main", "model": "tower@champion", "mean": 0.5},
    {"left": f"rtsp://10.0.0.9/main?password={SECRET}", "status": 1},
    {"left": f"rtsp:/pilot:{SECRET}@10.0.0.9/main", "status": 1},
    {"left": f"rtsp:pilot:{SECRET}@10.0.0.9/main", "status": 1},
    {"words": f'at "rtsp://pilot:a"{SECRET}@10.0.0.9/main"', "status": 1},
]


def test_what_stands_beside_an_address_is_kept(ship):
    cut = f'{{"words": "a", "left": "rtsp://pilot:{SECRET}@10.0.0.9/ma'
    whole = "".join(json.dumps(line) + "\n" for line in LINES)
    (ship / "dive.jsonl").write_text(whole + cut + "\n")
    _, parts = packed(ship, "--config", "dive.toml")
    assert SECRET not in "".join(parts.values())
    *lines, last = parts["logs/dive.jsonl"].splitlines()
    found = [json.loads(line) for line in lines]
    assert found[0] == LINES[0] and last.endswith("rtsp://10.0.0.9/ma")
    assert [line.get("status") for line in found[1:]] == [1] * 4
    source = tomllib.loads(parts["config.toml"])["source"]["source"]
    assert source == "rtsp://10.0.0.9:8554/main?password=..."


def test_a_frame_that_went_away_is_said_and_the_others_are_there(ship):
    (ship / "rec" / "run" / "left_2.png").symlink_to(ship / "away.png")
    done, parts = packed(ship, "--config", "dive.toml", "--frames")
    assert "left out: keys, tokens, passwords in addresses\n" in done.err
    assert parts["frames/run/left_1.png"] == "picture"
    assert "frames/run/left_2.png: " in parts["not_read.txt"]
