"""`tokt replay --export`: what a log says, read back from CSV and MCAP by others' readers."""

import csv
import json
import math
from datetime import datetime
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refused, succeeds
from tests.inference.logged_runs import lines, log_folder, write_lines
from tests.inference.replay.test_logged_run import BEGIN, FRAME, START, TODAY, log_of
from tests.tiers import scaled
from tokt.features.frames.mission import open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.recording.recorder import Recorder
from tokt.inference.replay.export import export_log
from tokt.inference.report import FIELDS
from tokt.models.bundle.bundle import read_bundle

mcap_reader = pytest.importorskip("mcap.reader")
typesys = pytest.importorskip("rosbags.typesys")
SCENES = [[], [(4, 4)], [(2, 7), (9, 0)]]
SEEN = {**TODAY, "seq": 2, "frame": 18, "t": 1461146472.5, "status": 1, "box": [36, 27, 72, 54]}
SEEN |= {"mean": 5.1, "distance_m": 1.75, "depth_m": 12.5, "lat_deg": 63.4, "lon_deg": 10.4}
BLIND = {**TODAY, "seq": 3, "frame": 19, "t": 1461146473.0, "status": -1, "reason": "dark"}
BEAT = {**BLIND, "seq": 4, "frame": None, "age_ms": 800.0}


@cache
def types_of(name, text):
    """The types of a schema as it stands in a file."""
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(text, name))
    return store


def messages(path):
    """Every message by its topic: (log time, what it says), by the schemas that are in the file."""
    found = {}
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == sum(1 for _ in reader.iter_messages())
        assert bool(summary.chunk_indexes) == bool(summary.channels)
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            store = types_of(schema.name, schema.data.decode())
            said = store.deserialize_cdr(message.data, schema.name)
            assert message.publish_time == message.log_time
            found.setdefault(channel.topic, []).append((message.log_time, said))
    return found


def fields_of(said):
    """The log's fields within a verdict's message."""
    return {each.key: json.loads(each.value) for each in said.status[0].values}


def rows(path):
    """A spreadsheet's rows, as one that knows no tokt reads them."""
    data = path.read_bytes()
    assert data.startswith(b"\xef\xbb\xbf") and data.endswith(b"\r\n")
    with path.open(encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def run_log(make_mission, bundle_file, tmp_path):
    """A run over three scenes with decision values; its log and its mission."""
    folder, log = make_mission(SCENES), tmp_path / "run.jsonl"
    log_folder(folder, bundle_file, log)
    return log, folder


def exported(log, target, *options):
    return json.loads(succeeds("replay", log, "--export", target, "--json", *options).out)


def test_a_run_reads_back_from_mcap_with_its_pictures_and_patches(run_log, bundle_file, tmp_path):
    log, folder = run_log
    target = tmp_path / "run.mcap"
    told = exported(log, target)
    assert (told["frames"], told["events"], told["with_picture"]) == (3, 1, 3)
    assert not told["notes"] and not told["no_picture"] and not told["damaged"]
    found, logged = messages(target), lines(log)
    assert [fields_of(said) for _, said in found["/tokt/verdict"]] == [
        {key: value for key, value in line.items() if key != "decision_values"} for line in logged
    ]
    mission, bundle = open_mission(folder), read_bundle(bundle_file)
    shown = zip(
        *(found[f"/tokt/{name}"] for name in ("left", "patches", "detections")), strict=True
    )
    for line, ((at, picture), (_, grid), (_, boxes)) in zip(logged, shown, strict=True):
        assert at == round(line["t"] * 1e9)
        assert at == picture.header.stamp.sec * 10**9 + picture.header.stamp.nanosec
        assert (picture.format, picture.header.frame_id) == ("jpeg", "left")
        assert bytes(picture.data) == mission.encoded(line["frame"])[0]
        obstacle = bundle.model.obstacle_patches(np.array(line["decision_values"]))
        cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)[::-1]
        assert cells.tolist() == np.where(obstacle, 100, 0).reshape(cells.shape).tolist()
        assert [each.id for each in boxes.detections] == ["obstacle"] * line["status"]
    assert [said.name for _, said in found["/tokt/events"]] == ["start"]


def test_the_reader_of_others_reads_it_too(run_log, tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader")
    export_log(run_log[0], tmp_path / "run.mcap")
    messages = reader.read_ros2_messages(tmp_path / "run.mcap")
    topics = [each.channel.topic for each in messages]
    assert topics.count("/tokt/left") == topics.count("/tokt/patches") == 3


def test_what_is_not_known_is_never_shown_as_free(tmp_path):
    log = log_of(tmp_path, [FRAME, SEEN, BLIND, BEAT], [BEGIN])
    target = tmp_path / "run.mcap"
    done = export_log(log, target)
    assert (done.frames, done.heartbeats, done.damaged, done.untimed) == (3, 1, 0, 0)
    found = messages(target)
    ids = [[each.id for each in said.detections] for _, said in found["/tokt/detections"]]
    assert ids == [[], ["obstacle"], ["unknown"], ["unknown"]]
    box = found["/tokt/detections"][1][1].detections[0].bbox
    place = box.center.position
    assert (place.x, place.y, box.size_x, box.size_y) == (72, 54, 72, 54)
    assert [said.status[0].level for _, said in found["/tokt/verdict"]] == [0, 1, 2, 2]
    assert found["/tokt/verdict"][2][1].status[0].message == "unknown (dark): ok"
    ranges = [said.range for _, said in found["/tokt/distance"]]
    assert ranges[0] == 1.75 and all(map(math.isnan, ranges[1:])) and len(ranges) == 3
    assert found["/tokt/verdict"][3][0] - found["/tokt/verdict"][2][0] == 800_000_000
    depths = [said.data for _, said in found["/tokt/depth_m"]]
    assert depths[0] == 12.5 and all(map(math.isnan, depths[1:])) and len(depths) == 3
    (_, place) = found["/tokt/position"][0]
    assert (place.latitude, place.longitude, place.status.status) == (63.4, 10.4, 0)
    assert math.isnan(place.altitude)  # over an ellipsoid, which the depth is not
    assert len(found["/tokt/position"]) == 3 and "/tokt/contact_s" not in found
    for _, place in found["/tokt/position"][1:]:
        assert math.isnan(place.latitude) and place.status.status == -1
    assert sum(done.no_picture.values()) == 3 and "--source" in done.notes[0]


def test_patches_of_a_frame_that_is_not_known_are_not_free(run_log, tmp_path):
    log, _ = run_log
    first, second, third = lines(log)
    del third["decision_values"]
    second["decision_values"][0] = [None]
    blind = {**first, "status": -1, "reason": "late"}
    other = {**first, "t": third["t"] + 1, "status": 0, "method": "disparity"}
    held = {**first, "t": third["t"] + 2, "status": 1}  # by the frame rule, or by disparity
    foreign = {**first, "t": third["t"] + 3, "model": "other/2"}  # of which the event is lost
    ragged = {**third, "decision_values": [[1.0]]}
    write_lines(log, [blind, second, third, ragged, other, held, foreign])
    grids = [said.data for _, said in messages_of(log, tmp_path)["/tokt/patches"]]
    assert set(grids[0]) == {-1} and set(grids[1]) == {-1, 0, 100}
    assert len(grids) == 7 and all(set(grid) == {-1} for grid in grids[2:])


def messages_of(log, folder):
    target = folder / "again.mcap"
    export_log(log, target)
    return messages(target)


def test_pictures_that_changed_or_went_are_told_and_left_out(run_log, tmp_path):
    log, folder = run_log
    files = sorted((folder / "Left").iterdir())
    files[0].unlink()
    cv2.imwrite(str(files[1]), np.zeros((50, 60, 3), np.uint8))
    target = tmp_path / "run.mcap"
    told = exported(log, target)
    assert told["with_picture"] == 1 and sum(told["no_picture"].values()) == 2
    found = messages(target)
    assert len(told["no_picture"]) == 2 and len(found["/tokt/left"]) == 1
    assert len(found["/tokt/right"]) == 3
    shown = succeeds("replay", log, "--export", target).out
    assert "1 frames with pictures, 2 without" in shown
    moved = folder.rename(tmp_path / "moved")
    assert exported(log, target)["with_picture"] == 0
    assert exported(log, target, "--source", moved)["with_picture"] == 1


def test_without_its_model_a_run_has_no_patches(run_log, tmp_path):
    log, _ = run_log
    target = tmp_path / "run.mcap"
    told = exported(log, target, "--store", tmp_path)
    assert len(told["notes"]) == 1 and told["with_picture"] == 3
    assert "/tokt/patches" not in messages(target)


def test_a_recording_is_exported_with_the_pictures_beside_it(make_mission, bundle_file, tmp_path):
    folder, log, kept = make_mission(SCENES), tmp_path / "run.jsonl", tmp_path / "rec"

    def recorder(run):
        return [Recorder(kept, run, SYSTEM_CLOCK, most_mb=100, reserve_mb=0)]

    started = {"record": str(kept), "source": "pymba:DEV_1"}
    run = log_folder(folder, bundle_file, log, how={"observers": recorder}, **started)
    whole, clip = tmp_path / "whole.mcap", tmp_path / "clip.mcap"
    assert exported(log, whole)["with_picture"] == 3
    told = exported(kept / run, clip)
    assert (told["with_picture"], told["damaged"]) == (3, 0)
    said = messages(clip)["/tokt/left"][0][1]
    assert cv2.imdecode(np.array(said.data), cv2.IMREAD_COLOR).shape == (271, 360, 3)


def test_older_files_and_all_runs_are_exported_in_order(tmp_path):
    other = {"run": "s", "t": FRAME["t"] + 60}
    log = log_of(tmp_path, [{**FRAME, **other}], [BEGIN, {**BEGIN, "run": "s"}])
    write_lines(tmp_path / "run.1.jsonl", [SEEN])
    write_lines(tmp_path / "run.2.jsonl", [FRAME])
    target = tmp_path / "run.csv"
    assert exported(log, target)["frames"] == 3
    assert [(row["run"], row["frame"]) for row in rows(target)] == [
        ("r", "17"), ("r", "18"), ("s", "17")
    ]  # fmt: skip
    assert exported(log, target, "--run", "r")["frames"] == 2
    refused("has no run x (it has r, s)", "replay", log, "--export", target, "--run", "x")


def test_events_after_the_last_frame_are_there_too(tmp_path):
    late = {**BEGIN, "event": "camera_lost", "words": "the left camera", "seq": 9, "t": 1.6e9}
    log = log_of(tmp_path, [FRAME], [BEGIN, late])
    target = tmp_path / "run.mcap"
    assert exported(log, target)["events"] == 2
    names = [(said.name, said.msg, said.file) for _, said in messages(target)["/tokt/events"]]
    assert names == [("start", "a run", "r"), ("camera_lost", "the left camera", "r")]


def test_a_spreadsheet_has_each_field_a_time_and_no_formula(tmp_path):
    text = '=cmd|"/c calc"!A1, "\u00e5"\n'
    log = log_of(tmp_path, [{**SEEN, "model": text, "health": "-1+1"}, BEAT], [BEGIN])
    target = tmp_path / "run.csv"
    exported(log, target)
    first, beat = rows(target)
    assert list(first) == ["time", *(each.name for each in FIELDS)]
    assert (first["model"], first["health"]) == (f"'{text}", "'-1+1")
    assert first["time"] == "2016-04-20T10:01:12.500000Z"
    assert datetime.fromisoformat(first["time"]).timestamp() == SEEN["t"]
    assert (first["box"], first["timed"]) == ("[36, 27, 72, 54]", "true")
    assert first["distance_m"] == "1.75"
    assert datetime.fromisoformat(beat["time"]).timestamp() == BEAT["t"] + 0.8
    assert (beat["frame"], beat["status"], beat["distance_m"]) == ("", "-1", "")


@pytest.mark.parametrize(
    ("damaged", "event"),
    [
        ({**FRAME, "status": 7}, BEGIN),
        ({**FRAME, "box": [1, 2]}, BEGIN),
        ({**FRAME, "t": "noon"}, BEGIN),
        ({"frame": 5, "run": "r"}, BEGIN),
        ({**FRAME, "seq": -1}, BEGIN),
        ("half a li", BEGIN),
        (None, {**BEGIN, "event": "model", "seq": None}),
        (None, {**BEGIN, "seq": "1"}),
    ],
)
def test_a_damaged_line_is_told_and_costs_no_other(damaged, event, tmp_path):
    """Not even one whose number says where the events belong."""
    log = log_of(tmp_path, [*([damaged] * bool(damaged)), FRAME], [event])
    log.write_text(log.read_text().replace('"half a li"', "half a li"))
    for name in ("run.csv", "run.mcap"):
        told = exported(log, tmp_path / name)
        assert (told["frames"], told["damaged"]) == (1, 1)
    shown = succeeds("replay", log, "--export", tmp_path / "run.csv").out
    assert "1 places of the log cannot be read and are left out" in shown
    assert len(rows(tmp_path / "run.csv")) == 1


def test_a_log_whose_events_are_lost_or_unreadable_is_exported(tmp_path):
    without = {key: value for key, value in BEGIN.items() if key != "policy"}
    nameless = {**START, "event": "model"}
    log = log_of(tmp_path, [FRAME], [without, nameless])
    told = exported(log, tmp_path / "run.mcap")
    assert (told["frames"], told["events"]) == (1, 2) and "start event" in told["notes"][0]
    (tmp_path / "run.events.jsonl").unlink()
    assert exported(log, tmp_path / "run.csv")["frames"] == 1
    refused("which is not there", "replay", log)


def test_lines_without_a_time_are_in_no_mcap(tmp_path):
    log = log_of(tmp_path, [{**BEAT, "t": None, "seq": 1}, FRAME, {**FRAME, "t": 1e12}], [BEGIN])
    assert exported(log, tmp_path / "run.mcap")["untimed"] == 2
    assert "2 lines left out" in succeeds("replay", log, "--export", tmp_path / "run.mcap").out
    assert [row["time"] for row in rows_of(log, tmp_path)][::2] == ["", ""]


def rows_of(log, folder):
    target = folder / "again.csv"
    export_log(log, target)
    return rows(target)


def test_what_cannot_be_exported_is_refused_and_leaves_nothing(tmp_path, monkeypatch):
    log = log_of(tmp_path, [FRAME], [BEGIN])
    target = tmp_path / "out" / "run.mcap"
    refused("not run.bag", "replay", log, "--export", "run.bag")
    refused("leave out --bundle", "replay", log, "--export", target, "--bundle", "a.tokt")
    refused("leave out --source", "replay", log, "--export", "a.csv", "--source", tmp_path)
    refused("no frames", "replay", log, "--export", tmp_path / "a.mcap", "--source", tmp_path)
    refused("cannot write", "replay", log, "--export", target)
    refused("does not exist", "replay", tmp_path / "no.jsonl", "--export", tmp_path / "a.csv")
    named = log.rename(tmp_path / "log.csv")
    refused("the ending of the log", "replay", named, "--export", named)
    named.rename(log)
    (tmp_path / "out").mkdir()
    monkeypatch.setattr("tokt.inference.replay.export.write_mcap", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export_log(log, target)
    assert list(target.parent.iterdir()) == []
    monkeypatch.setattr("tokt.inference.replay.export.find_spec", lambda _: None)
    refused("extra 'mcap'", "replay", log, "--export", target)


KINDS = {
    str: st.text(), float: st.floats(-1e12, 1e12), bool: st.booleans(),
    int: st.integers(0, 2**40), list: st.lists(st.integers(-5000, 5000), min_size=4, max_size=4),
    dict: st.dictionaries(st.text(), st.lists(st.integers(0, 99))),
}  # fmt: skip
LINES = st.lists(
    st.fixed_dictionaries(
        {
            **{each.name: st.none() | KINDS[each.kind] for each in FIELDS},
            "status": st.sampled_from([-1, 0, 1]),
            "t": st.floats(0, 2**31 - 2000),
            "age_ms": st.none() | st.floats(0, 1e6),
            "seq": st.integers(0, 2**40),
            "run": st.just("r"),
        }
    ),
    max_size=5,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("export")


@settings(max_examples=scaled(30))
@given(said=LINES)
def test_any_lines_read_back_the_same(folder, said):
    log = log_of(folder, said, [BEGIN])
    done = export_log(log, folder / "run.mcap")
    assert done.frames + done.heartbeats == len(said) and not done.damaged
    found = messages(folder / "run.mcap").get("/tokt/verdict", [])
    by_log = {json.dumps(fields_of(one), sort_keys=True) for _, one in found}
    assert by_log == {json.dumps(line, sort_keys=True) for line in said}
    for row, line in zip(rows_of(log, folder), said, strict=True):
        for each in FIELDS:
            cell, value = row[each.name], line[each.name]
            if isinstance(value, str):
                assert cell.removeprefix("'") == value
            else:
                assert (json.loads(cell) if cell else None) == value
