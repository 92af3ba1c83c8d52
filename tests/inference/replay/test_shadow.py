"""A challenger in a process of its own: what it says is compared, what it does harms nobody."""

import json
import multiprocessing
import os
import signal
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.calls import refused, refuses, succeeds
from tests.inference.live import HandSource, Listener
from tests.inference.logged_runs import lines, mission_source, variant, write_lines
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import assemble
from tokt.inference.policy.policy import Judgement
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.log import JsonLines
from tokt.inference.replay import shadow as shadow_module
from tokt.inference.replay.shadow import Challenger, Shadow
from tokt.inference.replay.shadow_report import read_shadow
from tokt.inference.report import EventQueue, Report
from tokt.inference.runtime import Runtime
from tokt.inference.verdict import unknown_verdict
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.operating_point import MofNRule

SCENES = [[], [(4, 4)], [(4, 4)], [], [(2, 7)], [], [], [(4, 4), (5, 5)], [(5, 5)], []]


class Shadowed:
    """A run of policy texture with a challenger."""

    def __init__(self, model, challenger, source, log, clock=SYSTEM_CLOCK) -> None:
        self.events = EventQueue()
        self.listener = Listener()
        self.shadow = Shadow(
            challenger, JsonLines(log), "run-1", source.live, clock, self.events.put
        )
        policy = assemble("texture", lambda: model, None).policy
        watching = [self.listener, self.shadow]
        self.runtime = Runtime(source, policy, [], clock, watching, events=self.events)

    def run(self) -> None:
        self.runtime.run()
        self.shadow.close()

    def told(self) -> list[str]:
        return [event.name for event in [*self.listener.events, *self.events.take()]]


def challenging(model: Bundle, policy: str = "texture") -> Challenger:
    return Challenger(model.label, model.sha256, model.data, policy)


def shadowed(model: Bundle, challenger: Challenger, folder: Path, log: Path) -> Shadowed:
    """A folder's frames, each judged by both."""
    run = Shadowed(model, challenger, mission_source(folder, SYSTEM_CLOCK), log)
    run.run()
    return run


def test_the_same_model_agrees_on_every_frame(make_mission, bundle_file, tmp_path):
    folder, log = make_mission(SCENES), tmp_path / "shadow.jsonl"
    (folder / "Left" / "t_L_6.jpg").write_bytes(b"no picture")
    model = read_bundle(bundle_file)
    run = shadowed(model, challenging(model), folder, log)
    compared = [line for line in lines(log) if "event" not in line]
    assert [line["frame"] for line in compared] == list(range(1, 11))
    for line in compared:
        champion, theirs = line["champion"], line["challenger"]
        assert champion.pop("latency_ms") > 0 and theirs.pop("latency_ms") > 0
        assert champion == theirs
    assert [line["champion"]["status"] for line in compared[4:6]] == [1, -1]
    report = read_shadow(log)
    assert (report.frames, report.agree, report.dropped, report.fault) == (10, 10, 0, "")
    assert run.told() == []


def test_where_another_model_says_otherwise_is_found(make_mission, bundle_file, tmp_path):
    folder, log = make_mission(SCENES), tmp_path / "shadow.jsonl"
    blind = read_bundle(variant(bundle_file, tmp_path / "blind.tokt", threshold=10.0))
    run = shadowed(read_bundle(bundle_file), challenging(blind), folder, log)
    assert run.told() == ["shadow_differs"] * 3
    found = json.loads(succeeds("shadow", log, "--json").out)
    assert found["champions"] == ["noise/7"] and found["challenger_model"]["label"] == "blind/7"
    assert (found["frames"], found["agree"]) == (10, 5)
    assert found["statuses"]["obstacle"] == {"obstacle": 0, "clear": 5, "unknown": 0}
    stretches = [(each["first"], each["last"], each["frames"]) for each in found["differences"]]
    assert stretches == [(2, 3, 2), (5, 5, 1), (8, 9, 2)]
    champion, theirs = found["champion"], found["challenger"]
    assert (champion["obstacle_alone_frames"], champion["obstacle_alone_stretches"]) == (5, 3)
    assert (champion["episodes"], champion["episodes_shared"], theirs["episodes"]) == (1, 0, 0)
    shown = succeeds("shadow", log)
    assert "frame 8-9 (2 frames): champion obstacle, challenger clear" in shown.out
    assert "in 3 stretches; 1 episode, 0 shared;" in shown.out


def test_in_real_time_it_misses_frames_and_may_die_and_the_champion_goes_on(
    draw_frame, bundle_file, tmp_path, hand_clock, request
):
    log, source = tmp_path / "shadow.jsonl", HandSource(hand_clock)
    rule = MofNRule(m=2, n=3)
    model = read_bundle(variant(bundle_file, tmp_path / "ruled.tokt", rule=rule))
    run = Shadowed(model, challenging(model), source, log, hand_clock)
    thread = threading.Thread(target=run.run, daemon=True)
    thread.start()
    reports, shadow = run.listener.reports, run.shadow

    def give(patches: list[tuple[int, int]]) -> None:
        expected = len(reports) + 1
        source.give(draw_frame(patches, len(reports)))
        until(lambda: len(reports) == expected)

    for _ in range(3):
        judged = shadow.judged_frames
        give([(4, 4)])
        until(lambda judged=judged: shadow.judged_frames > judged)
    child = shadow._process.pid
    assert child is not None and child != os.getpid()
    request.addfinalizer(shadow._kill)  # a stopped one would keep the tests from ending
    os.kill(child, signal.SIGSTOP)
    give([(4, 4)])
    until(lambda: shadow._waiting is None)
    for _ in range(4):
        give([(4, 4)])
    # One is with the stopped process, one waits; those between are overtaken.
    assert shadow.dropped >= 3
    os.kill(child, signal.SIGCONT)
    until(lambda: shadow.judged_frames == 5)
    os.kill(child, signal.SIGKILL)
    give([])
    until(lambda: shadow.fault)
    source.stop()
    thread.join(MAX_S)
    assert not thread.is_alive() and len(reports) == 9
    assert [report.verdict.status for report in reports[1:8]] == [1] * 7
    assert run.told() == ["shadow_failed"]
    compared = [line for line in lines(log) if "event" not in line]
    assert [line["dropped"] for line in compared] == [0, 0, 0, 0, 3]
    # Three frames before are not known to it, so that two of three cannot be said.
    assert [line["challenger"]["status"] for line in compared] == [-1, 1, 1, 1, -1]
    report = read_shadow(log)
    assert "exit code -9" in report.fault and report.dropped == 3


def test_a_challenger_that_cannot_be_loaded_or_hangs_is_told_once(
    make_mission, bundle_file, tmp_path, monkeypatch
):
    folder, log = make_mission(SCENES[:4]), tmp_path / "shadow.jsonl"
    model = read_bundle(bundle_file)
    damaged = replace(challenging(model), data=model.data[:300])
    run = shadowed(model, damaged, folder, log)
    assert len(run.listener.reports) == 4 and run.told() == ["shadow_failed"]
    assert "noise/7: " in read_shadow(log).fault
    # Lockstep with a process that does not even start up in time.
    monkeypatch.setattr(shadow_module, "ANSWER_S", 0.05)
    log = tmp_path / "hangs.jsonl"
    run = shadowed(model, challenging(model), folder, log)
    assert len(run.listener.reports) == 4 and run.told() == ["shadow_failed"]
    assert "does not answer" in read_shadow(log).fault
    assert not run.shadow._thread.is_alive()


def test_in_real_time_one_that_hangs_or_cannot_be_started_is_told(
    draw_frame, bundle_file, tmp_path, hand_clock, monkeypatch, request
):
    model, told = read_bundle(bundle_file), EventQueue()
    verdict = unknown_verdict(Fault(Reason.DARK, "dark"))

    def start(log: str) -> Shadow:
        lines = JsonLines(tmp_path / log)
        challenger = challenging(model)
        return Shadow(challenger, lines, "run-1", True, hand_clock, told.put)

    def see(shadow: Shadow, number: int) -> None:
        frame = Frame(number, 1.0, draw_frame([]), None)
        shadow.judged(frame, Judgement(verdict), Report(number, number, 1.0, 1.0, verdict))

    hangs = start("hangs.jsonl")
    request.addfinalizer(hangs._kill)
    see(hangs, 1)
    until(lambda: hangs.judged_frames and hangs._busy_since is None)
    hand_clock.now += 10 * shadow_module.ANSWER_S  # idle, which is no fault
    os.kill(hangs._process.pid or 0, signal.SIGSTOP)
    see(hangs, 2)
    until(lambda: hangs._waiting is None)
    hand_clock.suspend(10 * shadow_module.ANSWER_S)  # in which nobody answers
    see(hangs, 3)
    assert hangs.fault == ""
    hand_clock.now += shadow_module.ANSWER_S + 1
    see(hangs, 4)
    assert "does not answer" in hangs.fault
    hangs.close()
    assert not hangs._thread.is_alive()
    assert "does not answer" in read_shadow(tmp_path / "hangs.jsonl").fault

    def refuse(process: Any) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(multiprocessing.get_context("spawn").Process, "start", refuse)
    never = start("never.jsonl")
    until(lambda: never.fault)
    see(never, 1)
    never.close()
    assert "cannot be started: Resource temporarily" in read_shadow(tmp_path / "never.jsonl").fault
    assert [event.name for event in told.take()] == ["shadow_failed"] * 2


def test_policy_disparity_has_no_challenger(bundle_file):
    refuses("uses no model", challenging, read_bundle(bundle_file), "disparity")


def line(frame: int, champion: int, challenger: int, dropped: int = 0) -> dict[str, Any]:
    def said(status: int) -> dict[str, Any]:
        return {"status": status, "model": "a/1", "latency_ms": 10.0 + frame}

    both = {"champion": said(champion), "challenger": said(challenger)}
    return {"run": "r", "seq": frame, "frame": frame, "dropped": dropped, **both}


START = {
    "event": "start", "format_version": 1, "run": "r", "policy": "texture", "live": True,
    "challenger": {"label": "b/2", "sha256": "0" * 64},
}  # fmt: skip


def test_episodes_bridge_short_gaps_and_tell_who_begins_earlier(tmp_path):
    champion = [*range(5, 10), *range(15, 20), *range(40, 45)]
    theirs = [*range(7, 21), *range(38, 41), *range(70, 72)]
    frames = [line(n, int(n in champion), int(n in theirs)) for n in range(1, 81)]
    report = read_shadow(write_lines(tmp_path / "s.jsonl", [START, *frames]))
    episodes = {
        side: [(e.begins + 1, e.ends + 1) for e in found] for side, found in report.episodes.items()
    }
    assert episodes["champion"] == [(5, 19), (40, 44)]
    assert episodes["challenger"] == [(7, 20), (38, 40), (70, 71)]
    assert report.lead_frames() == [-2, 2]
    assert report.alone("champion") == (6, 2) and report.alone("challenger") == (10, 4)
    latency = report.latency("champion")
    assert (latency["median"], latency["max"]) == (50.5, 90.0)


def test_what_is_no_shadow_log_is_one_clear_line(tmp_path):
    path = tmp_path / "s.jsonl"
    for words, values in (
        ("does not exist", []),
        ("no run with a challenger", [{"run": "r", "event": "other"}]),
        ("is no shadow log", [START, {**line(1, 0, 0), "champion": 3}]),
        ("is no shadow log", [START, {**line(1, 0, 0), "frame": "1"}]),
        ("no status 9", [START, line(1, 0, 9)]),
        ("newer than this tokt", [{**START, "format_version": 2}]),
    ):
        if values:
            write_lines(path, values)
        refused(words, "shadow", path)
    write_lines(path, [START, line(1, 0, 0)])
    refused("no run x", "shadow", path, "--run", "x")
