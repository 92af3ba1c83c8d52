"""From sea back to training: what the runtime recorded is labelled and becomes a dataset."""

import json

import cv2
import numpy as np

from tests.calls import succeeds
from tokt.features.frames.mission import RIGHT, open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.policy.assembly import assemble
from tokt.inference.recording.recorder import Recorder
from tokt.inference.recording.recording import read_recording
from tokt.inference.runtime import Runtime
from tokt.inference.sources.files import open_source
from tokt.models.bundle.bundle import read_bundle

OCEAN = [0, 1, 2, 90, 91, 92]  # patches


def stereo_copy(mission, to):
    """The mission with a right camera, whose frames are those of the left one, brighter."""
    (to / "Left").mkdir(parents=True)
    (to / "Right").mkdir()
    for path in (mission / "Left").iterdir():
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        (to / "Left" / path.name).write_bytes(path.read_bytes())
        cv2.imwrite(str(to / "Right" / path.name.replace("_L_", "_R_")), cv2.add(picture, 5.0))
    return to


def record(mission, bundle_file, folder):
    """Run a model over a mission as at sea, recording what it warns of."""
    bundle = read_bundle(bundle_file)
    recorder = Recorder(folder, "run-1", SYSTEM_CLOCK, most_mb=100, reserve_mb=0)
    source = open_source(str(mission), SYSTEM_CLOCK)
    policy = assemble("texture", lambda: bundle, None).policy
    summary = Runtime(source, policy, [], SYSTEM_CLOCK, [recorder]).run()
    recorder.close()
    assert summary.obstacle > 5 and recorder.writer.frames > 10 and recorder.writer.dropped == 0
    return folder / "run-1"


def test_the_loop_from_sea_to_training_closes(tiny, tiny_bundle, page_server, tmp_path):
    sea = stereo_copy(tiny.path, tmp_path / "sea")
    recording = record(sea, tiny_bundle, tmp_path / "rec")
    lines = [line for line in read_recording(recording) if "event" not in line]
    recorded, mission = open_mission(recording), open_mission(sea)
    numbers = recorded.frames()
    assert numbers == recorded.frames(RIGHT) == [line["frame"] for line in lines]
    for number in numbers:  # to the last bit, so that what is labelled is what was judged
        for camera in mission.cameras:
            assert np.array_equal(recorded.read(number, camera), mission.read(number, camera))

    workspace = tmp_path / ".tokt"
    options = ("--annotator", "anna", "--model", tiny_bundle)
    server = page_server(*options, mission=recording, workspace=workspace)
    shown = server.get("/api/mission")
    assert shown["mission"] == "run-1" and shown["cameras"]["left"]["count"] == len(numbers)
    alarms = [line["frame"] for line in lines if line["status"] == 1][:4]
    query = {"camera": "left", "frames": ",".join(map(str, alarms)), "who": "anna"}
    found = server.get("/api/labels", suggest=1, **query)
    assert len(found["frames"]) == len(alarms)
    painted = 0
    for key, frame in enumerate(found["frames"]):
        number, classes = frame["frame"], frame["suggestions"]["classes"]
        warned = [cell for cell, name in enumerate(classes) if name == 1]
        assert warned  # the model suggests where it warned at sea
        server.paint(f"o-{key}", number, warned, "subsea_installation")
        ocean = [cell for cell in OCEAN if cell not in warned]
        server.paint(f"w-{key}", number, ocean, "ocean")
        painted += len(warned) + len(ocean)
    server.interrupt()

    build = ("dataset", "build", "from-sea", "--mission", recording, "--block", 1, "--json")
    dataset = json.loads(succeeds(*build, "--workspace", workspace).out)
    assert dataset["frames"] == len(alarms)
    assert dataset["labels"].keys() == {"ocean", "subsea_installation"}
    assert dataset["patches"] == painted


def test_other_files_beside_the_frames_do_not_matter(tiny, tiny_bundle, tmp_path):
    recording = record(tiny.path, tiny_bundle, tmp_path / "rec")
    before = open_mission(recording).frames()
    (recording / "recording.jsonl.copy").write_text("x")
    (recording / "Left" / ".partial-0123-run-1_L_3.png").write_bytes(b"half")
    (recording / "notes.png").write_bytes(b"")
    assert open_mission(recording).frames() == before
    assert open_mission(recording).cameras == ("left",)
