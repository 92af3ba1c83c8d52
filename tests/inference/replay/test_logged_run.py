"""Logs as anybody may have changed them: read, or refused with one line; and yesterday's start."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.inference.logged_runs import write_lines
from tokt.inference.config import Limits
from tokt.inference.recording.run_start import ModelName, RunStart, UsedFile
from tokt.inference.replay.logged_run import VERDICT, LoggedFrame, open_run

MODEL = ModelName("noise/7", "ab" * 32)
START = {"event": "start", "t": 1.5, "words": "a run", "run": "r", "seq": 0}
FRAME = {
    "v": 2, "seq": 1, "t": 1461146472.123456, "status": 0, "x": 0, "y": 0, "box": None, "mean": 0.0,
    "distance_m": None, "method": "texture", "model": "noise/7", "latency_ms": 4.1, "health": "ok",
    "closing_m_s": None, "contact_s": None, "reason": "ok", "age_ms": 5.7, "run": "r", "frame": 17,
    "missed": 0, "left_out": 0, "timed": True, "texture_s": 0.0031, "left": "0123abcd",
    "right": {"reason": "missing", "words": "not read"},
}  # fmt: skip
TODAY = {
    **dict.fromkeys(VERDICT), **FRAME, "trend": "growing", "trend_confidence": 0.962,
    "expansion_contact_s": 10.37, "anchor_x": 0.667, "anchor_y": 0.259, "anchor_size": -0.363,
}  # fmt: skip


STARTED = RunStart("dive", "fallback", model=MODEL, stereo_way="bm", stereo_scale=0.5)
BEGIN = {**START, **STARTED.fields()}


def log_of(folder: Path, frames: list[Any], events: list[Any]) -> Path:
    write_lines(folder / "run.events.jsonl", events)
    return write_lines(folder / "run.jsonl", frames)


def read(log: Path) -> list[LoggedFrame]:
    return list(open_run(log).frames())


def test_a_start_reads_back_as_it_was():
    rig, poses = UsedFile("/rig.yml", "0" * 64), UsedFile("/poses.csv", "1" * 64)
    start = replace(STARTED, live=True, limits=Limits(0.3, 0.7, 9), calibration=rig, odometry=poses)
    rest = {"pixel_format": "BayerRG8", "frame_rule": {"hits": 1}, "record": "/rec"}
    start = replace(start, **rest, model_fault="none", anchor=0.1)
    fields = json.loads(json.dumps({**START, **start.fields()}))
    assert RunStart.from_fields(fields, "a log") == start


def test_the_first_format_of_a_start_is_still_read():
    first = {
        "event": "start", "format_version": 1, "source": "/dive", "policy": "texture",
        "live": False, "limits": {"stale_s": 0.5, "heartbeat_s": 0.5, "frozen_repeats": 5},
        "model": {"label": "noise/7", "sha256": "ab" * 32}, "model_fault": "",
        "models_from": "/noise-7.tokt", "stereo_way": None, "stereo_scale": None,
        "calibration": None, "odometry": None, "pixel_format": None, "threads": 1,
        "frame_rule": None, "record": None, "software": {"tokt": "0.1.0"},
    }  # fmt: skip
    start = RunStart.from_fields(first, "a log")
    assert (start.model, start.models_from, start.model_note) == (MODEL, "/noise-7.tokt", "")
    assert start.anchor is None


def test_yesterday_s_line_is_read_with_what_it_has(tmp_path):
    log = log_of(tmp_path, [FRAME, {**TODAY, "seq": 2}], [BEGIN])
    yesterday, today = read(log)
    added = set(VERDICT) - set(yesterday.verdict)
    assert added == set(TODAY) - set(FRAME) and set(today.verdict) == set(VERDICT)
    assert today.verdict["trend"] == "growing"


def test_a_frame_s_line_is_read_with_its_model_and_what_follows_what(tmp_path):
    event = {"event": "model", "label": "new/1", "sha256": "cd" * 32, "run": "r", "seq": 2}
    told = {"event": "recording", "frame": 17, "run": "r", "seq": 1}
    # The heartbeat of the other thread was said after frame 4, and its line is before it.
    beats = [{**FRAME, "seq": seq, "frame": None} for seq in (3, 5)]
    lines = [FRAME, {**FRAME, "seq": 2}, *beats, {**FRAME, "seq": 4}]
    log = log_of(tmp_path, [*lines, {**FRAME, "seq": 7}], [BEGIN, told, event])
    run = open_run(log)
    frames = list(run.frames())
    assert run.n_frames == len(frames) == 4
    assert [(each.seq, each.exchanged) for each in frames] == [(1, 0), (2, 0), (4, 1), (7, 1)]
    assert frames[-1].model == ModelName("new/1", "cd" * 32)
    assert run.models == (MODEL, frames[-1].model)
    assert [each.follows for each in frames] == [True, True, True, False]  # 6 is nowhere
