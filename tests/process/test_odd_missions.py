"""Every command on missions that nobody would take: each ends with an answer or with one line.

Never with exit code 70, which is a fault of tokt, nor with a traceback.
"""

import os
import shutil
import signal
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from threading import Event, Thread
from urllib.error import HTTPError
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from tests.calls import call_tokt, free_port
from tests.fixtures import write_labels
from tests.inference.stereo.plain_rig import store_parts
from tests.waiting import MAX_S
from tokt.models.bundle.bundle import bundle_bytes, read_bundle

FRAMES = 6
SIDES = ("Left", "Right")


def texture(n):
    """Coarse noise, a little further on in each frame."""
    coarse = np.random.default_rng(5).normal(110, 40, (12, 20)).repeat(9, 0).repeat(9, 1)
    return coarse[:, n : n + 144].clip(0, 255).astype(np.uint8)


def of(picture, frames=FRAMES, sides=SIDES):
    """A mission of what `picture` gives for a frame and a side: a picture, or a file's bytes."""

    def make(folder):
        for frame in range(1, frames + 1):
            for side in sides:
                path = folder / side / f"m_{side[0]}_{frame}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                made = picture(frame, side)
                data = made if isinstance(made, bytes) else cv2.imencode(".png", made)[1]
                path.write_bytes(bytes(data))

    return make


def noise(height, width):
    rng = np.random.default_rng(5)
    return lambda frame, side: rng.integers(0, 255, (height, width), np.uint8)


def one_bad_file(folder):
    of(lambda frame, side: texture(frame))(folder)
    (folder / "Left" / "m_L_3.png").write_bytes(b"this is no picture")
    (folder / "Right" / "m_R_5.png").write_bytes(b"")


MISSIONS = {
    "no folders": lambda folder: folder.mkdir(),
    "empty folders": lambda folder: [(folder / side).mkdir(parents=True) for side in SIDES],
    "a text file": lambda folder: folder.write_text("no mission"),
    "black": of(lambda frame, side: np.zeros((108, 144), np.uint8)),
    "one frame": of(lambda frame, side: texture(frame), frames=1),
    "one camera": of(lambda frame, side: texture(frame), sides=["Left"]),
    "right camera only": of(lambda frame, side: texture(frame), sides=["Right"]),
    "1x1 pixels": of(noise(1, 1)),
    "3000x1 pixels": of(noise(1, 3000), frames=2),
    "4000x1500 pixels": of(lambda frame, side: cv2.resize(texture(frame), (4000, 1500)), frames=1),
    "left and right alike": of(lambda frame, side: texture(frame)),
    "two sizes": of(lambda frame, side: texture(frame)[:: 1 + frame % 2, :: 1 + frame % 2]),
    "sixteen bits and transparency by turns": of(
        lambda frame, side: (
            np.dstack([texture(frame)[:54, :72]] * 4)
            if (frame % 2) == (side == "Left")
            else texture(frame)[:54, :72].astype(np.uint16) * 257
        )
    ),
    "no pictures": of(lambda frame, side: b"this is no picture"),
    "cut pictures": of(
        lambda frame, side: cv2.imencode(".png", texture(frame))[1].tobytes()[:-900]
    ),
    "one bad file": one_bad_file,
}
HOLDS_NOTHING = {"no folders", "empty folders", "a text file", "right camera only", "no pictures"}
"""Where what takes minutes of a mission, `reproduce` and `bench`, must refuse at once."""
LABELS = ("labels", "ocean", "unsure", "none", "others")
"""Label files: sound, of one class, of none, without a row, of frames that are not there."""
FORMATS = {
    **{"viame": "viame.csv", "coco": "coco.json", "labelstudio": "studio.json", "patches": "cut"},
    **{"coralnet": "c.csv", "biigle": "b.csv", "cvat": "c.xml", "ifdo": "i.json"},
}
"""Formats that need the mission, and a file for each."""
RUN = "run --source MISSION --udp 127.0.0.1:9 --format v2 --policy"
SPLIT = "--folds 2 --embargo 1 --jobs 1"
COMMANDS = (
    "calibrate MISSION -o own.yml --report own.html",
    "calibrate MISSION --check --calibration rig.yml",
    "calibrate MISSION -o board.yml --board 3x3 --square 25",
    "depth MISSION --calibration rig.yml --ply cloud.ply",
    "depth MISSION --calibration rig.yml --stereo sgbm --scale 1 --pictures 1 --json",
    "labels import labels.csv",
    "labels export all.csv --full",
    *(f"labels export {FORMATS[name]} --format {name} --mission-dir MISSION" for name in FORMATS),
    *(f"labels import {name}.csv" for name in LABELS),
    "labels stats",
    "labels agreement labels ocean",
    "labels agreement none.csv others.csv",
    *(f"labels import {path} --mission-dir MISSION --workspace again" for path in FORMATS.values()),
    *(f"dataset build {name} --mission MISSION --labels {name}.csv --block 1" for name in LABELS),
    "dataset build drawn --mission MISSION",
    "dataset build folder --patches MISSION",
    "dataset show labels",
    f"train labels --extractor lbp --preset plain --name odd {SPLIT}",
    f"train labels --extractor lbp --preset thesis --name thesis {SPLIT}",
    "labels audit labels --folds 2 --jobs 1",
    f"search labels --budget 1 {SPLIT}",
    "export odd -o odd.tokt",
    "deploy odd.tokt store",
    "deploy sound.tokt store",
    "rollback store",
    "store store",
    *(f"evaluate sound.tokt --mission MISSION --labels {name}.csv" for name in LABELS),
    f"{RUN} texture --bundle sound.tokt --log t.jsonl --log-values --record clips --json",
    f"{RUN} either --bundle sound.tokt --calibration rig.yml --log e.jsonl "
    "--shadow sound.tokt --shadow-log s.jsonl",
    f"{RUN} disparity --calibration rig.yml --stereo pushbroom --rate 1000",
    f"{RUN} fallback --store store --calibration rig.yml --stereo sgbm --stereo-scale 1",
    "replay t.jsonl --bundle sound.tokt",
    "replay e.jsonl --bundle sound.tokt --source MISSION",
    "shadow s.jsonl",
    "demo --mission MISSION --labels labels.csv",
    "doctor --store store",
    "label MISSION --no-browser --no-token --model sound.tokt --port PORT",
)
COMPARE = "compare sound.tokt other.tokt --mission MISSION --labels labels.csv -o compared.html"
"""Of evaluations, which all missions have, a page that takes as long as all other commands."""
COMPARED = ("one bad file", "two sizes")
SLOW = ("reproduce MISSION -o thesis --sample 1 --jobs 1", "bench --quick --mission MISSION")
PAGES = ("", "mission", "labels", "queue", "picture/left/1", "thumb/left/1", "sheet", "patches")


def write_files(box, frames, mission):
    """A sound bundle's companions: a calibration of the frames' size, and label files."""
    image = next((found for file in frames if (found := cv2.imread(str(file))) is not None), None)
    height, width = (108, 144) if image is None else image.shape[:2]
    matrix = np.array([[1.6 * width, 0, width / 2], [0, 1.6 * width, height / 2], [0, 0, 1]])
    camera = {"K1": matrix, "D1": np.zeros(5), "K2": matrix, "D2": np.zeros(5), "R": np.eye(3)}
    size = {"T_mm": np.array([[-300.0], [0], [0]]), "image_width": width, "image_height": height}
    store_parts(box / "rig.yml", camera | size)
    n = max(1, len(frames))
    ours, both = range(1, n + 1), ("ocean", "subsea_installation")
    labelled = {"labels": (ours, both), "ocean": (ours, both[:1]), "unsure": (ours, ("unsure",))}
    labelled |= {"none": ((), ()), "others": ((900, 901), both)}
    for name, (numbers, classes) in labelled.items():
        rows = [
            [mission.stem, "left", frame, row, col, classes[row % len(classes)]]
            for frame in numbers
            for row in (2, 7)
            for col in range(10)
        ]
        write_labels(box / f"{name}.csv", rows)


@contextmanager
def page_looked_at(port):
    """Once the labelling page is there, its parts are asked for; then Ctrl-C. What they said."""
    ended, said = Event(), []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def status(path):
        try:
            with urlopen(f"http://127.0.0.1:{port}/{path}", timeout=MAX_S) as answer:
                return answer.status
        except HTTPError as error:
            return error.code
        except OSError:
            return None  # it has not begun

    def look():
        while not status(""):
            if ended.wait(0.02):
                return
        said.extend((page, status(f"api/{page}") or 599) for page in PAGES)
        os.kill(os.getpid(), signal.SIGINT)

    thread = Thread(target=look)
    thread.start()
    try:
        yield said
    finally:
        ended.set()
        thread.join()
        for number, handler in handlers.items():  # the server keeps them for good
            signal.signal(number, handler)


def fault_of(command, ran):
    errors = [line for line in ran.err.splitlines() if line.startswith("tokt: error: ")]
    judged = command.startswith(("calibrate MISSION --check", "replay", "doctor"))
    if "Traceback" in ran.out + ran.err or "Warning: " in ran.err:
        return "a traceback, or a warning of Python's"
    if ran.code == 2:
        return "" if len(errors) == 1 and ran.err.endswith(f"{errors[0]}\n") else "not one line"
    return "" if ran.code in (0, 1 if judged else 0) and not errors else f"exit code {ran.code}"


@pytest.mark.parametrize("name", MISSIONS)
def test_every_command_ends_with_an_answer_or_one_line(name, tmp_path, tiny_bundle, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # The page is served in this process, which it would end where answers take longer.
    monkeypatch.setattr("tokt.labels.page.api.serve._LAST_ANSWERS_S", MAX_S)
    mission = tmp_path / "mission"
    MISSIONS[name](mission)
    write_files(tmp_path, sorted(mission.glob("*/m_L_*")), mission)
    shutil.copy(tiny_bundle, tmp_path / "sound.tokt")
    other = bundle_bytes(replace(read_bundle(tiny_bundle).content, version="8"))
    (tmp_path / "other.tokt").write_bytes(other)
    port, faults = free_port(), []
    more = (COMPARE,) if name in COMPARED else SLOW if name in HOLDS_NOTHING else ()
    for command in (*COMMANDS, *more):
        if name == "4000x1500 pixels" and ("--board" in command or "sgbm" in command):
            continue  # a minute a picture
        words = [str({"MISSION": mission, "PORT": port}.get(w, w)) for w in command.split()]
        with page_looked_at(port) if command.startswith("label ") else nullcontext([]) as pages:
            ran = call_tokt(*words)
        fault = fault_of(command, ran) or [page for page in pages if page[1] >= 500]
        faults += [f"tokt {command}: {fault}\n{ran.err}"] if fault else []
    assert not faults, "\n".join(faults)
