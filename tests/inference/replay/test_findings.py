"""`tokt findings`: what frames show of a class becomes one thing, with its frames and its place."""

import csv
import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import call_tokt, refused, succeeds
from tests.inference.conftest import draw, write_mission
from tests.inference.logged_runs import lines, log_folder, write_lines
from tests.models.parts import golden_of
from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.inference.outputs.udp import decode, encode_v2
from tokt.inference.recording.run_log import events_path
from tokt.inference.recording.run_start import used_file
from tokt.inference.replay.findings import find
from tokt.inference.replay.logged_track import LoggedTrack, open_track
from tokt.inference.report import CLASSES_BYTES, DATAGRAM_BYTES, FIELDS, WITH_CLASSES, Report
from tokt.inference.verdict import Verdict
from tokt.models.bundle.bundle import bundle_bytes, read_bundle
from tokt.models.linear import LinearModel

GRID = Grid()
CLASSES = ("ocean", "pipe", "net")
STEP_M = 0.5


@pytest.fixture(scope="module")
def three_classes(bundle_file, tmp_path_factory):
    """A bundle of three classes: noise is a net, what is brighter than the water a pipe."""
    content = read_bundle(bundle_file).content
    extractor = read_bundle(bundle_file).extractor
    one = content.model
    weights = np.vstack([np.zeros_like(one.weights), np.zeros_like(one.weights), one.weights])
    bias = np.array([0.0, -1.0, one.bias[0]])
    model = LinearModel(weights, bias, np.zeros(3), CLASSES, (False, True, True))
    frame = draw([(4, 5)])
    values = model.decision_values(extractor.describe(frame, GRID))
    golden = golden_of([frame], [values], [model.obstacle_patches(values)])
    path = tmp_path_factory.mktemp("three") / "three-7.tokt"
    path.write_bytes(bundle_bytes(replace(content, name="three", model=model, golden=golden)))
    return path


def scene(frame: int) -> list[tuple[int, int]]:
    """A thing of two by two patches that comes down the picture in frames 4 to 10."""
    top = frame - 3
    return [(top + dy, 4 + dx) for dy in (0, 1) for dx in (0, 1)] if 1 <= top <= 7 else []


@pytest.fixture(scope="module")
def run_once(three_classes, tmp_path_factory):
    """A log of fourteen frames with that thing, and the folder of its frames."""
    root = tmp_path_factory.mktemp("run")
    folder = write_mission(root / "dive", [scene(frame) for frame in range(1, 15)])
    log_folder(folder, three_classes, root / "run.jsonl")
    return root / "run.jsonl", folder


@pytest.fixture
def logged(run_once, tmp_path):
    """A copy of the log that a test may change, and the folder of its frames."""
    log, folder = run_once
    for path in (log, events_path(log)):
        shutil.copy(path, tmp_path)
    return tmp_path / log.name, folder


def poses(path, frames=range(1, 15)):
    """Odometry of a straight way, `STEP_M` a frame."""
    rows = [f"{n},{n},0,0,{STEP_M * (n - 1)},1,0,0,0" for n in frames]
    path.write_text("\n".join(["frame,t,x_m,y_m,z_m,qw,qx,qy,qz", *rows]) + "\n", "utf-8")
    return path


def test_a_frame_tells_its_classes(logged):
    log, _ = logged
    for line in lines(log):
        cells = sorted(10 * row + col for row, col in scene(line["frame"]))
        assert line["class_patches"] == ({"net": cells} if cells else {})
        if not cells:
            assert line["classes"] == {}
            continue
        top = 27 * (cells[0] // 10)
        assert line["classes"] == {"net": [144, top, 72, 54, round(4 * 36 * 27 / (360 * 271), 3)]}
        assert decode(json.dumps(line).encode())["classes"] == line["classes"]


def test_older_logs_and_datagrams_have_no_classes(logged, tmp_path):
    log, _ = logged
    names = {each.name for each in FIELDS if each.since == WITH_CLASSES}
    assert names == {"classes", "class_patches"}
    old = [
        {name: value for name, value in line.items() if name not in names} for line in lines(log)
    ]
    assert decode(json.dumps(old[5]).encode())["classes"] is None
    write_lines(log, old)
    succeeds("replay", log)  # the fields that it has are the same
    refused("did not log classes yet", "findings", log, "-o", tmp_path / "out.csv")


@pytest.mark.parametrize("name", ["damage", "x" * 90, "\U0001f40b" * 30])
def test_a_datagram_fits_whatever_is_seen(name):
    boxes = {f"{name}{n}": (-1, 99999, 99999, 99999, 0.123) for n in range(40)}
    verdict = Verdict(1, 1, 1, None, 1.0, None, "texture", "m" * 420, "h" * 300, classes=boxes)
    data = encode_v2(Report(1, 1, 0.0, 1.0, verdict))
    sent = decode(data)["classes"]
    assert len(data) <= DATAGRAM_BYTES
    assert list(sent or {}) == list(boxes)[: len(sent or {})]  # the first ones, whole
    assert len(json.dumps(sent, separators=(",", ":"))) <= CLASSES_BYTES
    alone = decode(encode_v2(Report(1, 1, 0.0, 1.0, replace(verdict, model="m/1", health="ok"))))
    assert len(alone["classes"]) >= 1


def test_one_thing_is_one_finding_at_its_place(logged, tmp_path):
    log, folder = logged
    out = tmp_path / "out.geojson"
    odometry = poses(tmp_path / "poses.csv")
    ran = succeeds("findings", log, "-o", out, "--odometry", odometry, "--ahead", "2", "--json")
    (found,) = json.loads(ran.out)["findings"]
    assert (found["label"], found["first_frame"], found["last_frame"]) == ("net", 4, 10)
    assert found["frames"] == 7 and found["confidence"] == round(7 / 8, 2)
    assert found["mission"] == folder.name and found["grid"] == str(GRID)
    # Its centre is in the middle row of the picture, between rows 4 and 5, in frame 7.
    assert found["best_frame"] == 7 and found["patches"] == [44, 45, 54, 55]
    assert found["along_m"] == pytest.approx(6 * STEP_M + 2, abs=0.01)
    value = json.loads(out.read_text("utf-8"))
    assert (value["type"], value["tokt_findings"]) == ("FeatureCollection", 1)
    assert value["features"][0]["geometry"] is None  # the log has no position
    assert value["features"][0]["properties"] == found


def test_the_log_s_position_is_the_finding_s(logged, tmp_path):
    log, _ = logged
    placed = lines(log)
    for line in placed:
        line["lat_deg"] = 63.0 + math.degrees(STEP_M * line["frame"] / 6_371_000)
        line["lon_deg"], line["depth_m"] = 10.0, 31.5
    write_lines(log, placed)
    out = tmp_path / "out.geojson"
    succeeds("findings", log, "-o", out, "--ahead", "1")
    (feature,) = json.loads(out.read_text("utf-8"))["features"]
    lon, lat = feature["geometry"]["coordinates"]
    metres = math.radians(lat - 63.0) * 6_371_000
    assert lon == 10.0 and metres == pytest.approx(7 * STEP_M + 1, abs=0.02)
    assert feature["properties"]["along_m"] == pytest.approx(6 * STEP_M + 1, abs=0.02)
    assert feature["properties"]["depth_m"] == 31.5


def test_the_files_are_read_back(logged, tmp_path):
    log, folder = logged
    out = tmp_path / "out.csv"
    assert "out.csv: 1 finding" in call_tokt("findings", log, "-o", out).out
    with out.open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["finding"], row["label"], row["patches"]) == ("1", "net", "44 45 54 55")
    assert row["along_m"] == "" and row["run"]
    page = tmp_path / "out.html"
    succeeds("findings", log, "-o", page)
    text = page.read_text("utf-8")
    assert "1: net" in text and text.count("data:image/jpeg") == 1
    gone = lines(events_path(log))  # the pictures are, the findings are not
    write_lines(events_path(log), [{**line, "source": "/nowhere"} for line in gone])
    succeeds("findings", log, "-o", page)
    assert "The picture is not there." in page.read_text("utf-8")
    succeeds("findings", log, "-o", page, "--source", folder)
    assert "data:image/jpeg" in page.read_text("utf-8")


def test_what_is_asked_for_must_be_there(logged, tmp_path):
    log, _ = logged
    out = tmp_path / "out.geojson"
    knows = "its model knows no crack (it knows net, pipe)"
    refused(knows, "findings", log, "-o", out, "--classes", "crack")
    assert "0 findings" in call_tokt("findings", log, "-o", out, "--classes", "pipe").out
    refused(".geojson, .csv, .html", "findings", log, "-o", tmp_path / "out.kml")
    refused("name just one", "findings", log, log, "-o", out, "--run", "x")
    assert "0 findings" in call_tokt("findings", log, "-o", out, "--min-frames", "8").out
    assert "0 findings" in call_tokt("findings", log, "-o", out, "--min-patches", "5").out


def test_damaged_lines_are_left_out_and_said(logged, tmp_path):
    log, _ = logged
    damaged = lines(log)
    damaged[4]["class_patches"] = {"net": [100]}  # no such patch
    damaged[5]["distance_m"] = "near"
    write_lines(log, damaged)
    ran = call_tokt("findings", log, "-o", tmp_path / "out.csv")
    assert "2 damaged lines left out" in ran.err and "out.csv: 1 finding" in ran.out


def test_a_model_of_two_classes_has_no_findings(make_mission, bundle_file, tmp_path):
    log = tmp_path / "run.jsonl"
    log_folder(make_mission([[], [(4, 4)]]), bundle_file, log)
    assert {line["classes"] for line in lines(log)} == {None}
    refused("need a model of several classes", "findings", log, "-o", tmp_path / "out.csv")


def track(frames, along_m=None, classes=("damage", "net", "pipe")):
    """A track of frames that show these patches by class."""
    known = [
        {"frame": n, "t": float(n), "class_patches": seen, "distance_m": None}
        for n, seen in enumerate(frames, 1)
    ]
    along = np.arange(len(known)) * STEP_M if along_m is None else np.array(along_m, float)
    return LoggedTrack("log", "run-x", None, "dive", GRID, classes, known, along)


def blob(row, col, label="net"):
    return {label: [10 * row + col, 10 * row + col + 1, 10 * row + col + 10]}


def test_two_things_at_once_are_two():
    frames = [{"net": blob(row, 0)["net"] + blob(row, 7)["net"]} for row in range(1, 8)]
    assert len(find(track(frames), ["net"])) == 2


def test_a_thing_lost_for_a_moment_or_of_two_classes_by_turns_is_one():
    lost = [blob(row, 4) if row not in (4, 5) else {} for row in range(1, 9)]
    (found,) = find(track(lost), ["net"])
    assert (found.first_frame, found.last_frame, found.frames) == (1, 8, 6)
    assert found.confidence == round(6 / 9, 2)
    wavers = [blob(row, 4, "damage" if row == 5 else "net") for row in range(1, 9)]
    (found,) = find(track(wavers), ["net", "damage"])
    assert found.label == "net" and found.confidence == round(8 / 9 * 7 / 8, 2)


def test_what_is_in_most_frames_is_background():
    frames = [{"pipe": [3, 13, 23, 33], **(blob(row, 6) if row > 4 else {})} for row in range(1, 9)]
    assert [it.label for it in find(track(frames))] == ["net"]
    assert [it.label for it in find(track(frames), ["pipe"])] == ["pipe"]


@settings(max_examples=scaled(60))
@given(
    st.lists(
        st.dictionaries(
            st.sampled_from(["net", "pipe"]), st.lists(st.integers(0, 99), min_size=1), max_size=2
        ),
        max_size=12,
    ).filter(lambda frames: any("net" in seen for seen in frames))
)
def test_every_sighting_is_in_one_finding(frames):
    found = find(track(frames), ["net"], min_frames=1, min_patches=1)
    shows = [n for n, seen in enumerate(frames, 1) if "net" in seen]
    assert min(it.first_frame for it in found) == shows[0]
    assert max(it.last_frame for it in found) == shows[-1]
    for it in found:
        assert 0 < it.confidence < 1
        assert set(it.patches) <= set(frames[it.best_frame - 1]["net"])


def passing(n, every=8, col=4, label="net"):
    """Frames in which one thing after another comes down the picture, a row a frame."""
    return [blob(at % every + 1, col, label) if at % every < 8 else {} for at in range(n)]


def test_what_a_dive_shows_tells_where_rows_look():
    """Noise that was followed into a thing, or is far from it, does not move its place."""
    frames = passing(80, every=16)
    clean = [it.along_m for it in find(track(frames), ["net"])]
    assert clean == pytest.approx([STEP_M * (16 * k + 3 + 1 / 6) for k in range(5)], abs=0.05)
    for at in (8, 9, 24, 26, 41):  # patches between the things
        frames[at] = {"net": [44]}
    assert [it.along_m for it in find(track(frames), ["net"])] == pytest.approx(clean, abs=0.1)


def test_what_is_seen_where_no_position_is_known_is_found_too():
    frames = passing(80, every=16)
    along = np.arange(80) * STEP_M
    along[60:] = np.nan
    found = find(track(frames, along), ["net"])
    assert [it.along_m is None for it in found] == [False] * 4 + [True]
    assert (found[-1].first_frame, found[-1].frames) == (65, 8)


def test_what_runs_along_the_track_is_one_thing():
    pipe = [{"pipe": [row * 10 for row in range(10)]} for _ in range(80)]
    frames = [{**one, **two} for one, two in zip(pipe, passing(80, every=16), strict=True)]
    found = find(track(frames), ["net", "pipe"])
    assert [it.label for it in found].count("pipe") == 1
    assert [it.label for it in found].count("net") == 5


def test_a_track_over_the_date_line_goes_on(logged):
    log, _ = logged
    placed = lines(log)
    for line in placed:
        line["lat_deg"] = 0.0
        east = math.degrees(STEP_M * (line["frame"] - 7) / 6_371_000)
        line["lon_deg"] = (180.0 + east + 180.0) % 360.0 - 180.0
    write_lines(log, placed)
    known = open_track(log)
    assert known.along_m[-1] == pytest.approx(13 * STEP_M, abs=0.01)
    lat, lon = known.place(6 * STEP_M)
    assert lat == 0.0 and abs(lon) == pytest.approx(180.0, abs=1e-6)


def test_the_run_s_own_odometry_must_be_unchanged(run_once, three_classes, tmp_path):
    log, given = tmp_path / "second.jsonl", poses(tmp_path / "given.csv")
    log_folder(run_once[1], three_classes, log, odometry=used_file(given))
    assert open_track(log).along_m[-1] == pytest.approx(13 * STEP_M)
    poses(given, range(1, 10))
    refused("is not the one that the run had", "findings", log, "-o", tmp_path / "out.csv")
