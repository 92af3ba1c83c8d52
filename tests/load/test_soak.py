"""`make soak`: a short one through the real programs, and what its figures are made of."""

import json
import os
import signal
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.fault_rows import rows_by_fault
from tests.load.soak import plan as soak_plan
from tests.load.soak.fault_results import fault_results, longest_without_fault_s, without_fault
from tests.load.soak.faults import BACK_S, FAULTS, SILENCE_S, STALL_S
from tests.load.soak.feed import Feeder, Truth, pictures, receiver
from tests.load.soak.injector import Injection, altered_frames, draw_faults
from tests.load.soak.plan import EXPECTED, FrameKind, SoakSize, number_of, plan, time_of
from tests.load.soak.run import Around, Run
from tests.load.soak.standstill import StandstillWatch, overlap_s
from tests.load.soak.synthetic_frames import bundles
from tests.load.soak.verdict import growth
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.freshness.frozen_frames import StuckFrameDetector
from tokt.inference.monitoring.watchdog import HANG_S
from tokt.inference.outputs.udp import encode_v1, encode_v2
from tokt.inference.policy.assembly import assemble
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.report import Report
from tokt.inference.sources.stream import StreamSource
from tokt.inference.verdict import Verdict, unknown_verdict, verdict_from_mask

HELD_ON_ANY_MACHINE = {"frames", "datagrams", "verdicts", "faults", "heartbeats", "log"}


@pytest.fixture(scope="module", autouse=True)
def coarse_figures():
    """None: pixels are looked at."""


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_short_soak(run_load, tmp_path, monkeypatch):
    short = replace(soak_plan.QUICK, frames=300, bare_frames=50, kills=0, rest_s=1e-3)
    short = replace(short, pauses=2, fault_every=70, log_mb=0.05)
    short = replace(short, look_every_s=1.0)  # few looks, also on a busy machine: no growth
    monkeypatch.setattr(soak_plan, "QUICK", short)
    ran = run_load("soak", "--quick", "--json", "--out", tmp_path / "out")
    found = json.loads(ran.out)
    checks = {check["name"]: check for check in found["checks"]}
    assert [checks[name] for name in HELD_ON_ANY_MACHINE if not checks[name]["holds"]] == []
    assert ran.code == (0 if found["holds"] else 1)
    rows = [each["row"] for each in found["injections"]]
    assert set(rows) == set(short.fault_rows) and len(rows) == 4
    assert found["pauses"]["heard"] > 0
    assert found["heard"]["compared_v1"] > 250
    assert 0 < found["latency"]["age"]["median_ms"] < found["latency"]["round_trip"]["median_ms"]
    assert found["samples"][-1]["resident"] > 10e6 and found["memory"] is None
    assert json.loads((tmp_path / "out" / "soak.json").read_text()) == found
    chart = cv2.imread(str(tmp_path / "out" / "soak.png"))
    assert chart is not None and min(chart.shape[:2]) > 400


def test_a_plan_is_the_same_for_all_and_holds_every_kind():
    kinds = plan(20_000)
    assert np.array_equal(kinds[:5000], plan(5000)) and len(kinds) == 20_000
    assert set(kinds.tolist()) == set(map(int, FrameKind)) == set(map(int, EXPECTED))
    assert [number_of(time_of(number)) for number in (0, 1, 999_999)] == [0, 1, 999_999]
    # A picture is repeated as often as it may be, and only then is it frozen.
    starts = np.flatnonzero((kinds[1:] == FrameKind.FROZEN) & (kinds[:-1] != FrameKind.FROZEN)) + 1
    repeats = Limits().frozen_repeats
    for start in starts.tolist():
        assert set(kinds[start - repeats : start].tolist()) == {int(FrameKind.SAME)}
        assert kinds[start - repeats - 1] == FrameKind.WATER


@pytest.mark.parametrize("kind", FrameKind)
def test_the_model_says_of_every_kind_what_the_plan_expects(kind):
    kinds = plan(20_000)
    first = int(np.flatnonzero(kinds == kind)[0])
    kinds = kinds[max(first - 20, 0) : first + 3]
    (model,) = bundles(1)
    policy, stuck_frames = (
        assemble("texture", lambda: model, None).policy,
        StuckFrameDetector(Limits()),
    )
    for number, picture in enumerate(pictures(kinds)):
        fault = Fault(Reason.MISSING, "no picture") if picture is None else NO_FAULT
        frame = Frame(number, time_of(number), picture, None, fault, timed=True)
        verdict = policy.judge(stuck_frames.remove(frame)).verdict
        stuck_frames.prepare()
        assert (verdict.status, verdict.reason) == EXPECTED[FrameKind(kinds[number])]


def test_memory_that_grows_and_memory_that_does_not():
    rng = np.random.default_rng(1)
    frames = np.arange(0.0, 1e6, 1000.0)
    still = 80e6 + rng.normal(0, 1e6, len(frames))
    flat = growth(frames, still)
    assert flat is not None and flat["low"] < 0 < flat["high"]
    grown = growth(frames, still + 5.0 * frames)
    assert grown is not None and 0 < grown["low"] < 5.0 < grown["high"] < grown["low"] + 1.0
    assert grown["mb_per_day"] == pytest.approx(grown["bytes_per_frame"] * 15 * 86400 / 1e6)
    # What fills up at the start is no growth.
    warming = growth(frames, np.minimum(frames * 400, still))
    assert warming is not None and warming["low"] <= 0
    assert growth(frames[:20], still[:20]) is None
    assert growth(np.zeros(0), np.zeros(0)) is None


def test_memory_that_grows_in_every_life_of_a_runtime():
    rng = np.random.default_rng(2)
    frames = np.tile(np.arange(0.0, 30_000, 1000), 20)
    lives = np.repeat(np.arange(20.0), 30)
    still = 80e6 + rng.normal(0, 1e5, len(frames)) + 1e6 * rng.normal(0, 1, 20)[lives.astype(int)]
    flat = growth(frames, still, lives)
    assert flat is not None and flat["low"] < 0 < flat["high"]
    grown = growth(frames, still + 100.0 * frames, lives)
    assert grown is not None and 0 < grown["low"] < 100.0 < grown["high"]


def test_every_fault_that_is_injected_is_a_row_of_the_page():
    rows = rows_by_fault()
    assert [each.row for each in FAULTS if each.row not in rows] == []
    assert len({each.row for each in FAULTS}) == len(FAULTS)
    for fault in FAULTS:
        row = rows[fault.row]
        starts_again = "restarts +1" in row.counted or row.comes_to.startswith("back with")
        assert fault.restarts or not starts_again, row
        assert fault.verdicts or not fault.pictures, row
    bounds = {each.row: each.silence_bound.seconds for each in FAULTS}
    assert bounds["the log's file is deleted"] == SILENCE_S
    assert bounds["SIGKILL at any moment"] == BACK_S
    assert bounds["the runtime hangs altogether"] == HANG_S + BACK_S
    assert bounds["a stream that stalls within a frame"] == STALL_S + SILENCE_S


def test_faults_are_drawn_as_often_each_where_the_water_is_clear():
    size = SoakSize(frames=200_000, fault_every=1000)
    kinds = plan(size.frames)
    drawn = draw_faults(kinds, size)
    assert drawn == draw_faults(kinds, size) and len(drawn) == 197
    times = Counter(fault.row for _, fault in drawn)
    assert len(times) == len(FAULTS) and max(times.values()) - min(times.values()) <= 1
    assert all(kinds[number] == FrameKind.WATER for number, _ in drawn)
    altered = altered_frames(drawn)
    assert sum(fault.pictures is not None for _, fault in drawn) < len(altered) < 200
    named = draw_faults(kinds, replace(size, fault_rows=("glare",)))
    assert {fault.row for _, fault in named} == {"glare"}


def test_silences_go_to_the_fault_that_lasted_and_the_machine_s_own_are_left_out():
    def injection(row: str, from_s: float, bound_s: float, *missing: str) -> Injection:
        return Injection(row, 0, False, bound_s, "a heartbeat", from_s, from_s + 10, missing)

    injections = [injection("glare", 10, 0.7), injection("SIGKILL at any moment", 15, 1.7, "x")]
    around = Around(None, injections, 2, 0, standstills=[(31.0, 31.5)])
    heard_s = np.array([5.0, 12.0, 30.0, 0.0])
    run = Run(None, {}, {}, np.array([1.0, 1.0, 1.0, 0.0]), heard_s, heard_s, [], 40.0, around)
    silences = [(9.5, 10.5), (16.0, 17.5), (30.9, 31.7), (33.0, 33.4)]
    run = replace(run, silences=silences)
    killed, glare = fault_results(run)[::-1]
    assert (glare.longest_s, killed.longest_s) == (1.0, 1.5)
    assert not glare.is_heard and killed.is_heard and killed.missing == ("x",)
    assert longest_without_fault_s(run) == pytest.approx(0.4)
    assert without_fault(run).tolist() == [True, False, True, False]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_machine_that_stands_still():
    with StandstillWatch() as watch:
        before = time.monotonic()
        os.kill(watch._process.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(watch._process.pid, signal.SIGCONT)
        gaps = watch.gaps()
    whole = before, time.monotonic()
    assert sum(overlap_s(gap, whole) for gap in gaps) > 0.2


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_runtime_that_dies_with_a_frame_and_the_next_one():
    waits = unknown_verdict(Fault(Reason.NO_FRAME, "no frame has come yet"))
    with closing(Feeder(plan(5))) as feeder, ThreadPoolExecutor(1) as pool, receiver() as sender:
        addresses = [("127.0.0.1", int(text.rpartition(":")[2])) for text in feeder.receivers]
        running = pool.submit(feeder.run, lambda number, kind: None)
        for first, judged in ((0, [0, 1]), (3, [3, 4])):
            with closing(StreamSource(feeder.address, SYSTEM_CLOCK)) as source:
                frames = iter(source)
                sender.sendto(encode_v2(Report(1, None, None, None, waits)), addresses[1])
                for seq, number in enumerate(judged, 2):
                    assert next(frames).number == number
                    sender.sendto(encode_v1(CLEAR_VERDICT), addresses[0])
                    sender.sendto(encode_v2(report(seq, number, CLEAR_VERDICT)), addresses[1])
                if first == 0:
                    assert next(frames).number == 2  # and it dies with it
        running.result()
    found = {"datagrams": 6, "starts": 2, "heartbeats": 2, "of_water": 4, "lost_on_the_way": 1}
    assert +feeder.truth.found == {**found, "compared_v1": 4}
    assert feeder.age_s.astype(bool).tolist() == [True, True, False, True, True]


def report(seq: int, number: int, verdict: Verdict) -> Report:
    return Report(seq, number, time_of(number), 1.0, verdict, 1.5)


CLEAR_VERDICT = verdict_from_mask(np.zeros((135, 180), np.uint8), "texture")
OBSTACLE_VERDICT = verdict_from_mask(np.full((135, 180), 255, np.uint8), "texture")


def hear(truth: Truth, said: Report, v1: Verdict | None = None) -> float | None:
    return truth.hear(said.frame, encode_v2(said), encode_v1(v1 or said.verdict))


def test_the_receiver_sees_what_is_wrong():
    kinds = plan(3000)
    near = int(np.flatnonzero(kinds == FrameKind.NEAR)[0])
    truth = Truth(kinds)
    assert hear(truth, report(1, 0, CLEAR_VERDICT)) == 1.5
    hear(truth, report(2, near, OBSTACLE_VERDICT))
    heard = {"datagrams": 2, "starts": 1, "of_water": 1, "of_near": 1, "compared_v1": 2}
    assert +truth.found == heard
    assert truth.worst is None
    stale = unknown_verdict(Fault(Reason.STALE, "no frame for 0.5 s"))
    assert truth.hear(2, encode_v2(Report(3, None, None, None, stale, 600.0)), None) is None
    assert truth.found["no_such_frame"] == 1
    hear(truth, report(4, near + 1, CLEAR_VERDICT))
    assert truth.found["wrong_clear"] == 1 and truth.worst["kind"] == "near"
    hear(truth, report(5, 1, OBSTACLE_VERDICT), v1=CLEAR_VERDICT)
    assert truth.found["wrong_obstacle"] == 1 and truth.found["different_v1"] == 1
    hear(truth, report(6, 2, unknown_verdict(Fault(Reason.FROZEN, "held up"))))
    assert truth.found["cautious"] == 1
    hear(truth, report(7, 3, unknown_verdict(Fault(Reason.DARK, "dark"))))
    assert truth.found["other"] == 1
    hear(truth, report(8, 4, unknown_verdict(Fault(Reason.DARK, "dark"))), v1=CLEAR_VERDICT)
    assert truth.found["different_v1"] == 2
    truth.hear(5, encode_v2(report(9, 5, CLEAR_VERDICT)), None)
    assert truth.found["lost_v1"] == 1
    hear(truth, report(12, 6, CLEAR_VERDICT))
    assert truth.found["lost"] == 2
    hear(truth, report(12, 6, CLEAR_VERDICT))
    truth.hear(7, encode_v2(report(13, 6, CLEAR_VERDICT)), None)
    assert truth.found["no_such_frame"] == 3
    assert truth.hear(7, b"{}", None) is None
    assert truth.found["unreadable"] == 1
