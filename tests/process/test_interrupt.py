"""Ctrl-C at any moment of each command that works for long: it ends, and prints no traceback."""

import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing

import pytest

from tests.forking import ForkHost
from tests.inference.test_faults import hold_row
from tests.process.test_kill import moments
from tests.waiting import MAX_S

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs fork")
TRIALS = 4
SPLIT = "--folds 3 --embargo 1"
COMMANDS = {
    "dataset build": "dataset build more --mission MISSION --labels LABELS --block 3",
    "train": f"train tiny --extractor lbp --preset plain {SPLIT}",
    "search": f"search tiny --budget 1 {SPLIT}",
    "evaluate": "evaluate tiny-lbp --mission MISSION --labels LABELS",
    "compare": "compare tiny-lbp second -o report.html",
    "labels import": "labels import LABELS",
    "labels audit": "labels audit tiny",
    "export": "export tiny-lbp -o m.tokt",
    "deploy": "deploy BUNDLE store",
    "replay": "replay run.jsonl --bundle BUNDLE --source MISSION",
    "doctor": "doctor",
}
ON_THE_MISSION = {
    "calibrate": "calibrate PAIRS -o own.yml --frames 160-168",
    "depth": "depth PAIRS --calibration CALIBRATION --ply cloud.ply --frames 160-168",
}
BEFORE = {
    "replay": "run --bundle BUNDLE --source MISSION --udp 127.0.0.1:9 --log run.jsonl",
    "compare": f"train tiny --extractor lbp --preset thesis --name second {SPLIT}",
}


@pytest.fixture(scope="module")
def host(preload):
    with closing(ForkHost(preload)) as made:
        yield made


def run(host, words, interrupt_after_s=None):
    """Exit code, or minus the signal; all that was printed."""
    process = host.start(*words)
    if interrupt_after_s is not None:
        try:
            process.wait(interrupt_after_s)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
    with process.stdout, process.stderr:
        code = process.wait(MAX_S)
        return code, process.stdout.read() + process.stderr.read()


def check(host, words, reset):
    """Interrupt a command at seeded moments all over its duration."""
    began = time.monotonic()
    code, text = run(host, words)
    assert code == 0, text
    duration_s, hits = time.monotonic() - began, 0
    for trial, moment in enumerate(moments(random.Random(5), duration_s, TRIALS)):
        if trial >= TRIALS and hits:
            break
        reset()
        code, text = run(host, words, moment)
        assert code in (0, 130, -signal.SIGINT), text
        assert "Traceback" not in text and "Interrupt" not in text, text
        hits += code != 0
    assert hits, "each Ctrl-C came too late; the test proves nothing"
    hold_row(
        "Ctrl-C at any moment of a command that works for long",
        "ends within 3 s, code 130, no traceback; what was there still loads",
        "nothing",
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_at_any_moment(name, host, workspace, tiny, tiny_bundle, tmp_path, monkeypatch):
    def filled(words):
        return [places.get(word, word) for word in words.split()]

    def reset():
        shutil.rmtree(workspace)
        shutil.copytree(saved, workspace)

    monkeypatch.chdir(tmp_path)
    places = {"MISSION": tiny.path, "LABELS": tiny.labels, "BUNDLE": tiny_bundle}
    if name in BEFORE:
        code, text = run(host, filled(BEFORE[name]))
        assert code == 0, text
    saved = shutil.copytree(workspace, tmp_path / "saved")
    check(host, filled(COMMANDS[name]), reset)


@pytest.mark.mission
@pytest.mark.parametrize("name", ON_THE_MISSION)
def test_at_any_moment_on_the_mission(name, host, mission_dir, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calibration = mission_dir.parent / "calibration.yml"
    places = {"PAIRS": mission_dir, "CALIBRATION": calibration}
    words = [places.get(word, word) for word in ON_THE_MISSION[name].split()]
    check(host, words, reset=list)
