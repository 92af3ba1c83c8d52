"""What a run writes down: frames, heartbeats, events."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.inference.live import Sent
from tokt.inference.frame import Frame, pixel_mark
from tokt.inference.policy.policy import Judgement, SinglePolicy
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.log import LogRotation, read_log
from tokt.inference.recording.run_log import RunLog, events_path
from tokt.inference.recording.run_start import new_run_id
from tokt.inference.report import FIELDS, Event, Report
from tokt.inference.runtime import Runtime
from tokt.inference.sources.files import open_source
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import unknown_verdict

NOTHING = unknown_verdict(Fault(Reason.STALE, "no frame judged for 0.5 s"))


def test_a_frame_s_line_has_what_was_sent_and_what_was_seen(
    make_mission, noise_scorer, hand_clock, tmp_path
):
    folder = make_mission([[], [(4, 4)]])
    (folder / "Right" / "t_R_2.jpg").unlink()
    sent = Sent()
    log = RunLog(tmp_path / "log.jsonl", "run-x", values=True)
    source = open_source(str(folder), hand_clock)
    policy = SinglePolicy(TextureDetector(noise_scorer))
    Runtime(source, policy, [sent], hand_clock, [log]).run()
    log.close()
    first, second = read_log(tmp_path / "log.jsonl")
    frames = list(open_source(str(folder), hand_clock))
    for line, report, frame in zip((first, second), sent.reports, frames, strict=True):
        assert report.fields().items() <= line.items()
        assert list(line) == [*(each.name for each in FIELDS), "decision_values"]
        for each in FIELDS:
            value = line[each.name]
            kinds = {float: (float, int), str: (str, dict)}.get(each.kind, (each.kind,))
            assert type(value) in kinds or (value is None and each.nullable), each.name
        assert (line["run"], line["frame"], line["missed"]) == ("run-x", frame.number, 0)
        assert line["timed"] is False and line["texture_s"] is None and line["left_out"] == 0
        assert frame.left is not None and line["left"] == pixel_mark(frame.left)
        expected = noise_scorer.decision_values(frame.left)
        np.testing.assert_array_equal(np.array(line["decision_values"]), expected)
    assert first["right"] == pixel_mark(frames[0].right)  # type: ignore[arg-type]
    assert second["right"] == {"reason": "missing", "words": str(frames[1].right_fault)}


def test_heartbeats_and_events_have_their_lines(tmp_path):
    log = RunLog(tmp_path / "a.jsonl", "run-x")
    log.event(Event(1.5, "start", "it begins", {"policy": "texture"}))
    log.heartbeat(Report(1, None, None, None, NOTHING))
    log.event(Event(2.5, "model", "another one"))
    log.close()
    (line,) = read_log(tmp_path / "a.jsonl")
    assert line["frame"] is None and (line["seq"], line["reason"]) == (1, "stale")
    assert events_path(tmp_path / "a.jsonl") == tmp_path / "a.events.jsonl"
    start = {"event": "start", "t": 1.5, "words": "it begins", "run": "run-x", "seq": 0}
    model = {"event": "model", "t": 2.5, "words": "another one", "run": "run-x", "seq": 1}
    assert list(read_log(tmp_path / "a.events.jsonl")) == [{**start, "policy": "texture"}, model]


def test_values_that_are_not_finite_cost_no_line(tmp_path):
    log = RunLog(tmp_path / "a.jsonl", "run-x", values=True)
    values = np.array([[math.nan], [1 / 3], [math.inf]])
    fault = Fault(Reason.NOT_FINITE, "decision values are not finite")
    judgement = Judgement(unknown_verdict(fault), values)
    picture = np.zeros((4, 4), np.uint8)
    frame = Frame(7, math.nan, picture, None)
    log.judged(frame, judgement, Report(1, 7, math.nan, math.nan, judgement.verdict))
    log.close()
    (line,) = read_log(tmp_path / "a.jsonl")
    assert line["decision_values"] == [[None], [1 / 3], [None]]
    assert line["t"] is line["latency_ms"] is None and log.failed == 0


def test_both_files_step_on(tmp_path):
    log = RunLog(tmp_path / "a.jsonl", "run-x", LogRotation(0.002, 2))
    for seq in range(1, 60):
        log.heartbeat(Report(seq, None, None, None, NOTHING))
        log.event(Event(0.0, "overload", "no time", {"frames": seq}))
    log.close()
    names = {path.name for path in tmp_path.iterdir()}
    assert {"a.2.jsonl", "a.events.2.jsonl"} <= names and len(names) == 6
    seqs = [line["seq"] for line in read_log(tmp_path / "a.jsonl")]
    assert seqs == list(range(seqs[0], 60))
    assert all("event" in line for line in read_log(tmp_path / "a.events.jsonl"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full (Linux)")
def test_lines_of_both_files_that_cannot_be_written_are_counted(tmp_path):
    (tmp_path / "a.jsonl").symlink_to("/dev/full")
    log = RunLog(tmp_path / "a.jsonl", "run-x")
    log.heartbeat(Report(1, None, None, None, NOTHING))
    log.event(Event(0.0, "odd", "not JSON", {"value": math.nan}))
    assert log.failed == 2


def test_runs_have_ids_of_their_own_though_the_clock_stands(hand_clock):
    ids = {new_run_id(hand_clock) for _ in range(50)}
    assert len(ids) == 50
    assert all(name.startswith("run-19700112-134820-") for name in ids)


def test_a_log_of_before_there_were_reasons_is_read(tmp_path):
    line = {"v": 2, "seq": 1, "t": 1.0, "status": 0, "health": "ok", "frame": 17}
    (tmp_path / "old.jsonl").write_text(json.dumps(line) + "\n")
    assert list(read_log(tmp_path / "old.jsonl")) == [line]
