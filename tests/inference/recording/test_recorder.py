"""Recording frames around detections: what is kept, where, and what can go wrong."""

import json
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.calls import refuses
from tests.waiting import MAX_S, until
from tokt.features.frames.mission import RIGHT, open_mission
from tokt.inference.frame import Frame, pixel_mark
from tokt.inference.policy.policy import Judgement
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.clip_trigger import REST_S
from tokt.inference.recording.recorder import BEHIND, NO_ROOM, REPEATED, RESERVE, Recorder
from tokt.inference.recording.recording import (
    RECORDING_FORMAT,
    DiskBudget,
    EncodedFrame,
    RecordingFolder,
    read_recording,
    whole_blocks,
)
from tokt.inference.report import Event, Report
from tokt.inference.verdict import Verdict

OBSTACLE = Verdict(1, 3, 4, None, 9.0, 2.5, "texture", "reef/7")
CLEAR = Verdict(0, 0, 0, None, 0.0, None, "texture", "reef/7")
UNPAIRED = Fault(Reason.UNPAIRED, "no right frame of this moment")
ROOMY = (100, 0)  # megabytes, and those to spare


def noise(seed: int, colour: bool = False) -> NDArray[np.uint8]:
    """A picture that does not compress: 10 kB, or 30 kB in colour."""
    shape = (100, 100, 3) if colour else (100, 100)
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


class Sea:
    """Frames one after the other, 8 a second, as a recorder is told of them."""

    def __init__(self, recorder: Recorder, folder: Path) -> None:
        self.recorder = recorder
        self.folder = folder
        self.number = 0

    def see(self, verdict: Verdict, times: int = 1, **more: Any) -> None:
        for _ in range(times):
            self.number += 1
            now = self.number / 8
            left = more.get("left", noise(self.number))
            given: dict[str, Any] = {"right": None, "timed": True, "arrived": now, **more}
            frame = Frame(number=self.number, t=1000 + now, **{**given, "left": left})
            report = Report(self.number, frame.number, frame.t, 5.0, verdict, 6.0)
            self.recorder.judged(frame, Judgement(verdict, texture_s=0.25), report)

    def tell(self, name: str, **fields: Any) -> None:
        self.recorder.event(Event(1.0, name, "in words", fields))

    def written(self, frames: int) -> None:
        """Wait until so many frames are on disk, or left out."""
        until(lambda: self.recorder.writer.frames + self.recorder.writer.dropped >= frames)

    def end(self, bound_mb: float | None = None) -> list[int]:
        """The numbers of what was recorded, which is whole."""
        self.recorder.close()
        return check_whole(self.folder, bound_mb)


@pytest.fixture
def sea(tmp_path, hand_clock):
    """A recorder into ``tmp_path / "rec"`` with frames to see."""

    def start(around=(0.375, 0.25), disk=ROOMY, run="run-1", **more) -> Sea:
        recorder = Recorder(tmp_path / "rec", run, hand_clock, *around, *disk, **more)
        return Sea(recorder, tmp_path / "rec" / run)

    return start


def frame_lines(folder: Path) -> list[dict[str, Any]]:
    return [line for line in read_recording(folder) if "event" not in line]


def size_of(folder: Path) -> int:
    sizes = []
    for path in folder.rglob("*"):
        try:
            sizes.append(whole_blocks(path.stat().st_size) if path.is_file() else 0)
        except FileNotFoundError:  # renamed meanwhile
            continue
    return sum(sizes)


def check_whole(folder: Path, bound_mb: float | None = None) -> list[int]:
    """Each line's pictures are there, whole and those that were judged; the numbers."""
    mission = open_mission(folder)
    lines = frame_lines(folder)
    for line in lines:
        for side in ("left", "right"):
            name = line["files"].get(side)
            assert (name is None) == isinstance(line[side], dict)
            if name is not None:
                assert (folder / name).is_file()
                assert pixel_mark(mission.read(line["frame"], side)) == line[side]
    numbers = [line["frame"] for line in lines]
    assert numbers == sorted(set(numbers))
    if bound_mb is not None:
        assert size_of(folder.parent) <= 1e6 * bound_mb
    return numbers


def test_frames_around_a_detection_are_a_mission(sea):
    told: list[Event] = []
    at_sea = sea(tell=told.append)
    at_sea.tell("start", policy="texture")
    at_sea.see(CLEAR, 8, right=noise(99))
    at_sea.see(OBSTACLE, 2, right=noise(99, colour=True), left=noise(98, colour=True))
    at_sea.see(CLEAR, 10, right=noise(99))
    folder = at_sea.folder
    assert at_sea.end() == [6, 7, 8, 9, 10, 11, 12]
    mission = open_mission(folder)
    assert mission.cameras == ("left", "right") and mission.name == "run-1"
    assert mission.frames() == mission.frames(RIGHT) == [6, 7, 8, 9, 10, 11, 12]
    assert np.array_equal(mission.read(7), noise(7))
    assert np.array_equal(mission.read(9), noise(98, colour=True))
    assert np.array_equal(mission.read(9, RIGHT), noise(99, colour=True))
    head, *lines = (folder / "recording.jsonl").read_text().splitlines()
    assert json.loads(head) == {"recording": RECORDING_FORMAT, "run": "run-1"}
    event, *frames = read_recording(folder)
    assert (event["event"], event["policy"], event["seq"]) == ("start", "texture", 0)
    assert len(frames) + 1 == len(lines)
    ninth = frames[3]
    assert ninth["files"] == {"left": "Left/run-1_L_9.png", "right": "Right/run-1_R_9.png"}
    assert (ninth["status"], ninth["t"], ninth["texture_s"]) == (1, 1001.125, 0.25)
    assert (ninth["seq"], ninth["judged"], ninth["moment"]) == (9, 9, 1)
    assert [event.words for event in told] == ["recording frames around frame 9: obstacle"]
    recorder = at_sea.recorder
    assert (recorder.writer.frames, recorder.writer.dropped, recorder.clips) == (7, 0, 1)


def test_a_frame_without_a_picture_is_told_and_one_camera_is_enough(sea):
    at_sea = sea()
    at_sea.see(OBSTACLE, 2, right_fault=UNPAIRED)
    torn = Fault(Reason.INCOMPLETE, "the left frame is torn")
    at_sea.see(CLEAR, left=None, left_fault=torn, right_fault=UNPAIRED, missed=4)
    folder = at_sea.folder
    assert at_sea.end() == [1, 2, 3]
    assert open_mission(folder).cameras == ("left",)
    last = frame_lines(folder)[-1]
    assert last["files"] == {} and last["missed"] == 4
    assert last["left"] == {"reason": "incomplete", "words": str(torn)}


def test_without_a_detection_there_is_no_folder(sea, tmp_path):
    at_sea = sea()
    at_sea.tell("start")
    at_sea.see(CLEAR, 50)
    at_sea.recorder.close()
    assert [path.name for path in (tmp_path / "rec").iterdir()] == [".recording.lock"]


def test_a_new_model_keeps_its_place_among_the_frames_before_a_detection(sea):
    at_sea = sea(around=(0.5, 0))
    at_sea.see(CLEAR, 2)
    at_sea.tell("model", label="reef/8")
    at_sea.tell("camera_lost")
    at_sea.see(CLEAR, 2)
    at_sea.see(OBSTACLE)
    at_sea.recorder.close()
    found = [line.get("event", line["seq"]) for line in read_recording(at_sea.folder)]
    assert found == [1, 2, "model", 3, 4, 5]


def test_drift_and_a_challenger_that_differs_open_moments(sea):
    at_sea = sea(around=(0.125, 0.125))
    at_sea.see(CLEAR, 5)
    at_sea.tell("drift")
    at_sea.see(CLEAR, 5)
    at_sea.tell("shadow_differs")
    at_sea.see(CLEAR, 5)
    assert at_sea.end() == [5, 6, 7, 10, 11, 12]


def test_the_oldest_moments_of_the_run_make_room(sea):
    at_sea = sea(around=(0.125, 0.125), disk=(0.5, 0))
    at_sea.tell("start")
    folder = at_sea.folder
    for moment in range(1, 26):
        at_sea.see(CLEAR, 5)
        at_sea.see(OBSTACLE, 2)
        at_sea.written(4 * moment - 1)
        assert size_of(folder.parent) <= 5e5
    numbers = at_sea.end(bound_mb=0.5)
    assert open_mission(folder).frames() == numbers
    lines = frame_lines(folder)
    moments = sorted({line["moment"] for line in lines})
    # Whole moments have gone, and the newest are there.
    assert moments == list(range(moments[0], 26)) and 1 < moments[0] < 22
    assert len(numbers) == 4 * len(moments) - 1
    assert next(iter(read_recording(folder)))["event"] == "start"
    writer = at_sea.recorder.writer
    assert (writer.dropped, writer.fault) == (0, "") and writer.removed_bytes > 0


def test_earlier_recordings_are_never_touched(sea, tmp_path, hand_clock):
    before = tmp_path / "rec" / "run-0" / "Left" / "run-0_L_1.png"
    before.parent.mkdir(parents=True)
    before.write_bytes(bytes(900_000))
    told: list[Event] = []
    at_sea = sea(disk=(0.9, 0), tell=told.append)
    at_sea.see(OBSTACLE, 3)
    at_sea.written(3)
    at_sea.see(CLEAR)
    assert (at_sea.recorder.writer.frames, at_sea.recorder.writer.dropped) == (0, 3)
    assert at_sea.recorder.writer.fault == NO_ROOM and before.stat().st_size == 900_000
    assert told[-1].fields["fault"] == NO_ROOM and 1 <= told[-1].fields["dropped"] <= 3
    at_sea.written(4)
    before.unlink()  # somebody has copied it ashore
    hand_clock.now += 2 * REST_S
    at_sea.number += 100
    at_sea.see(OBSTACLE, 3)
    at_sea.written(7)
    at_sea.see(CLEAR)
    at_sea.recorder.close()
    assert at_sea.recorder.writer.frames == 3 + 1 and at_sea.recorder.writer.fault == ""
    assert told[-1].words == "frames are recorded again"


def test_the_disk_keeps_its_reserve(sea):
    at_sea = sea(disk=(100, 1e12))
    at_sea.see(OBSTACLE, 3)
    at_sea.recorder.close()
    assert at_sea.recorder.writer.dropped == 3 and at_sea.recorder.writer.fault == RESERVE
    assert not at_sea.folder.exists()


def test_a_slow_disk_costs_frames_and_neither_memory_nor_the_loop(sea, monkeypatch):
    go_on, write = threading.Event(), RecordingFolder.write

    def slow(self: RecordingFolder, encoded: Any) -> None:
        go_on.wait()
        write(self, encoded)

    monkeypatch.setattr(RecordingFolder, "write", slow)
    at_sea = sea(memory_mb=0.3)
    recorder = at_sea.recorder
    at_sea.see(CLEAR, 10)
    for _ in range(100):
        at_sea.see(OBSTACLE)
        assert recorder.writer.held_bytes <= 3e5
    assert (recorder.writer.frames, recorder.writer.fault) == (0, BEHIND)
    assert recorder.writer.dropped > 50
    go_on.set()
    numbers = at_sea.end()
    assert len(numbers) == recorder.writer.frames == 103 - recorder.writer.dropped
    # What came first is there, and the gap shows.
    judged = [line["judged"] for line in frame_lines(at_sea.folder)]
    assert judged == numbers == list(range(8, 8 + len(numbers)))


def test_frames_before_a_detection_are_bounded_in_memory(sea):
    at_sea = sea(around=(30, 0), memory_mb=0.1)
    at_sea.see(CLEAR, 200)
    at_sea.see(OBSTACLE)
    assert 190 < at_sea.end()[0] <= 200


def test_numbers_that_come_again_are_left_out(sea):
    at_sea = sea()
    at_sea.see(OBSTACLE, 3)
    at_sea.written(3)
    at_sea.number = 1
    at_sea.see(OBSTACLE, 1)
    at_sea.written(4)
    assert (at_sea.recorder.writer.dropped, at_sea.recorder.writer.fault) == (1, REPEATED)
    at_sea.see(OBSTACLE, 2)
    assert at_sea.end() == [1, 2, 3, 4]
    assert at_sea.recorder.writer.dropped == 2


def test_a_recording_that_is_taken_away_begins_anew(sea, tmp_path):
    told: list[Event] = []
    at_sea = sea(around=(0, 0), tell=told.append)
    at_sea.tell("start")
    at_sea.see(OBSTACLE, 3)
    at_sea.written(3)
    at_sea.folder.rename(tmp_path / "ashore")
    until(lambda: at_sea.recorder._recording.taken == 3)  # though no frame is written
    at_sea.see(OBSTACLE, 3)
    assert at_sea.end() == [4, 5, 6]
    assert [event.fields["taken"] for event in told if "taken" in event.fields] == [3]
    (tmp_path / "ashore").rename(tmp_path / "rec" / "run-0")
    assert check_whole(tmp_path / "rec" / "run-0") == [1, 2, 3]
    for run in ("run-0", "run-1"):
        assert next(iter(read_recording(tmp_path / "rec" / run)))["event"] == "start"


def test_a_recording_that_is_taken_away_within_a_frame_has_its_head_again(tmp_path):
    recording = RecordingFolder(tmp_path / "run-1", "run-1")
    recording.tell({"event": "start"})

    def encoded(number: int) -> EncodedFrame:
        return recording.encode(number, 1, {"left": noise(1)}, {"frame": number})

    recording.write(encoded(1))
    begun = encoded(2)
    (tmp_path / "run-1").rename(tmp_path / "ashore")
    with pytest.raises(OSError, match="taken away"):
        recording.write(begun)
    recording.write(encoded(3))
    event, line = read_recording(tmp_path / "run-1")
    assert event == {"event": "start"} and line["frame"] == 3
    assert [path.name for path in (tmp_path / "run-1" / "Left").iterdir()] == ["run-1_L_3.png"]


def test_one_process_records_into_a_folder(sea, tmp_path, hand_clock):
    first = sea()
    refuses("another tokt", sea, run="run-2")
    first.recorder.close()
    sea(run="run-2").recorder.close()
    (tmp_path / "file").write_text("")
    refuses("cannot record into", Recorder, tmp_path / "file", "run-1", hand_clock)
    for limits in ((0, 0), (1, -1), (float("nan"), 0)):
        refuses("is no limit", DiskBudget, tmp_path, *limits)


def test_what_is_no_recording_is_told(tmp_path):
    refuses("holds no recording", lambda: list(read_recording(tmp_path)))
    for text, words in (
        ("", "does not begin"),
        ('{"recording": true}\n', "does not begin"),
        ('{"recording": 2, "run": "x"}\n', "newer than this tokt reads"),
    ):
        (tmp_path / "recording.jsonl").write_text(text)
        refuses(words, lambda: list(read_recording(tmp_path)))


def test_a_recording_of_format_1_is_read(tmp_path):
    line = {"seq": 3, "status": 1, "frame": 9, "judged": 3, "moment": 1, "files": {}}
    text = json.dumps({"recording": 1, "run": "run-1"}) + "\n" + json.dumps(line) + "\n"
    (tmp_path / "recording.jsonl").write_text(text + '{"seq": 4, "fra')
    assert list(read_recording(tmp_path)) == [line]


_AT_SEA = """
import resource, sys, time
from pathlib import Path
from tests.inference.recording.test_recorder import CLEAR, OBSTACLE, Sea, noise
from tokt.inference.recording.recorder import Recorder
from tokt.inference.clock import SYSTEM_CLOCK
folder, run, most_mb, frames = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]), int(sys.argv[4])
at_sea = Sea(Recorder(folder, run, SYSTEM_CLOCK, 0.2, 0.2, most_mb, 0), folder / run)
"""
_FOR_EVER = """
for moment in range(frames):
    at_sea.see(CLEAR, 6)
    at_sea.see(OBSTACLE, 3, right=noise(1))
    at_sea.written(6 * moment)
"""
_FULL = """
unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
at_sea.see(OBSTACLE, 5)
at_sea.written(5)
resource.setrlimit(resource.RLIMIT_FSIZE, (6000, unlimited[1]))  # no picture fits the disk
at_sea.see(OBSTACLE, 5)
at_sea.written(10)
writer = at_sea.recorder.writer
print(writer.frames, writer.dropped, writer.fault, flush=True)
resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
at_sea.see(OBSTACLE, 5)
at_sea.recorder.close()
print(writer.frames, writer.dropped, writer.fault)
"""


def at_sea_process(program: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", _AT_SEA + program, *map(str, arguments)]
    root = Path(__file__).parents[3]
    return subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, text=True)


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_a_kill_at_any_moment_leaves_a_recording(tmp_path):
    rng = random.Random(3)
    for run in ("run-1", "run-2"):
        bound_mb = 0.35 * int(run[-1])
        process = at_sea_process(_FOR_EVER, tmp_path, run, bound_mb, 10**6)
        lines = tmp_path / run / "recording.jsonl"
        until(lines.exists)
        began = lines.stat().st_ino
        until(lambda lines=lines, began=began: lines.stat().st_ino != began)  # made room once
        time.sleep(rng.uniform(0, 0.2))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert len(check_whole(tmp_path / run, bound_mb)) > 3


@pytest.mark.skipif(sys.platform == "win32", reason="needs RLIMIT_FSIZE")
def test_a_full_disk_is_counted_and_recording_goes_on_when_it_is_not(tmp_path):
    process = at_sea_process(_FULL, tmp_path, "run-1", 100, 0)
    out, _ = process.communicate(timeout=MAX_S)
    full, after = out.splitlines()
    assert full == "5 5 File too large" and after == "10 5 "
    assert check_whole(tmp_path / "run-1") == [*range(1, 6), *range(11, 16)]
    assert not list((tmp_path / "run-1").rglob(".partial*"))
