"""Frames of two simulated cameras: true pairs, every fault with its reason, and never a hang."""

import functools
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from tests.calls import refuses
from tests.inference.test_faults import hold_row
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.monitoring.watchdog import RESTARTS_VARIABLE, Notifier, Watchdog
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.inference.sources.cameras import live_source
from tokt.inference.sources.cameras.capture import LEFT, RIGHT, Capture, Deliver
from tokt.inference.sources.cameras.live_source import CameraSource
from tokt.inference.sources.open import open_camera_source

from .simulated_rig import RATE_HZ, seen


def is_pair(frame: Frame) -> bool:
    return frame.left is not None and frame.right is not None


def check(frames: list[Frame]) -> None:
    """Every picture is whole and of its camera, every pair of one moment, every gap explained."""
    for frame in frames:
        views = ((0, frame.left, frame.left_fault), (1, frame.right, frame.right_fault))
        moments = set()
        for camera, picture, fault in views:
            assert (picture is None) == bool(fault)
            if picture is not None:
                of, moment = seen(picture)
                assert of == camera
                moments.add(moment)
        assert len(moments) <= 1
        assert frame.timed and frame.arrived is not None
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(set(numbers))


@pytest.fixture
def quick(simulator, live):
    """For tests that do not ask how clocks are compared: twice the rate, and shared clocks.

    Their pairs do not depend on when captures arrive, and so not on how busy the machine is.
    """
    simulator.set(-1, rate=2 * RATE_HZ)
    return functools.partial(live, ptp=True)


def test_pairs_of_one_moment_whatever_the_clocks(simulator, live):
    simulator.set(0, clock_offset_s=1000)
    simulator.set(1, delay_s=0.004, jitter_s=0.003)
    cameras = live()
    frames = [frame for _ in range(11) for frame in cameras.until(is_pair)]
    check(frames)
    assert cameras.events == []
    ages = [SYSTEM_CLOCK.monotonic() - frame.arrived for frame in frames[-1:]]
    assert 0 <= ages[0] < MAX_S and abs(frames[-1].t - time.time()) < MAX_S


def test_one_camera(simulator, live):
    cameras = live("pymba:1")
    frames = cameras.take(5)
    for frame in frames:
        assert seen(frame.left)[0] == 1 and frame.right is None
        assert frame.right_fault.reason is Reason.MISSING
    assert simulator.opened == [0, 1]


def test_frames_that_a_camera_drops(simulator, quick):
    simulator.set(0, drop_every=3)
    simulator.set(1, drop_every=4)
    cameras = quick()
    cameras.until(is_pair)
    missing = [(Reason.OK, Reason.OK), (Reason.OK, Reason.UNPAIRED), (Reason.UNPAIRED, Reason.OK)]
    wanted = Counter(3 * missing)

    def all_seen(frame: Frame) -> bool:
        wanted[frame.left_fault.reason, frame.right_fault.reason] -= 1
        return max(wanted.values()) <= 0

    frames = cameras.until(all_seen)
    check(frames)
    pairs = [seen(frame.left)[1] for frame in frames if is_pair(frame)]
    assert all(moment % 3 and moment % 4 for moment in pairs)
    assert min(counts.left_out for counts in cameras.source.counts) >= 3
    assert min(counts.unpaired for counts in cameras.source.counts) >= 3


def test_a_dropped_frame_of_a_single_camera_is_told_as_missed(simulator, live):
    simulator.set(0, drop_every=4)
    simulator.set(-1, rate=100)
    cameras = live("pymba:0")
    cameras.take(8)  # its clock is known by then
    missed: list[int] = []

    def both_seen(frame: Frame) -> bool:
        missed.append(frame.missed)
        return len(missed) >= 12 and {*missed} >= {0, 1}

    frames = cameras.until(both_seen)
    for before, frame in pairwise(frames):
        assert frame.missed == seen(frame.left)[1] - seen(before.left)[1] - 1
        assert frame.number - before.number == 1 + frame.missed


def test_incomplete_frames_are_counted_and_told(simulator, quick):
    simulator.set(1, incomplete_every=4)
    cameras = quick()
    cameras.until(is_pair)

    def is_torn(frame: Frame) -> bool:
        return frame.left is not None and frame.right_fault.reason is Reason.INCOMPLETE

    frames = cameras.until(is_torn) + cameras.until(is_torn)
    check(frames)
    whole = [seen(frame.right)[1] for frame in frames if frame.right is not None]
    torn = [seen(frame.left)[1] for frame in frames if is_torn(frame)]
    assert all(moment % 4 for moment in whole) and not any(moment % 4 for moment in torn)
    assert cameras.source.counts[RIGHT].incomplete >= len(torn)


def test_a_reader_that_is_slow_gets_the_newest(simulator, quick):
    cameras = quick()
    last = cameras.until(is_pair)[-1]
    time.sleep(6 / RATE_HZ)  # 12 periods
    frames = cameras.until(is_pair)
    check([last, *frames])
    between = seen(frames[-1].left)[1] - seen(last.left)[1] - 1
    told = sum(frame.missed for frame in frames) + len(frames) - 1
    assert between >= 9 and told >= between


def test_the_left_camera_is_pulled_out_and_put_back(simulator, quick):
    cameras = quick()
    frames = cameras.until(is_pair)
    simulator.set(0, plugged=0)
    frames += cameras.until(lambda frame: frame.left_fault.reason is Reason.CAMERA_LOST)
    lost = cameras.take(10)
    assert {frame.left_fault.reason for frame in lost} == {Reason.CAMERA_LOST}
    assert {frame.missed for frame in lost} == {MANY_MISSED}
    assert "left: camera 0 is no longer found" in frames[-1].left_fault
    simulator.set(0, plugged=1)
    back = cameras.until(lambda frame: frame.left is not None)
    reasons = [frame.left_fault.reason for frame in lost[-1:] + back]
    first = len(reasons) - reasons[::-1].index(Reason.CAMERA_LOST) - 1
    assert back[first].missed == MANY_MISSED
    again = cameras.until(is_pair) + cameras.take(5)
    check(frames + lost + back + again)
    assert max(frame.missed for frame in again[1:]) < MANY_MISSED
    assert cameras.event_names == [("camera_lost", "left"), ("camera_back", "left")]
    assert cameras.source.counts[LEFT].lost == 1


def test_the_right_camera_is_pulled_out_and_the_left_goes_on(simulator, quick):
    cameras = quick()
    cameras.until(is_pair)
    simulator.set(1, plugged=0)
    cameras.until(lambda frame: frame.right_fault.reason is Reason.CAMERA_LOST)
    frames = cameras.take(10)
    check(frames)
    assert all(frame.left is not None and frame.missed < MANY_MISSED for frame in frames)
    assert {frame.right_fault.reason for frame in frames} == {Reason.CAMERA_LOST}
    simulator.set(1, plugged=1)
    check(cameras.until(is_pair))
    assert cameras.event_names == [("camera_lost", "right"), ("camera_back", "right")]


def test_a_camera_that_falls_silent_is_started_again(simulator, live, monkeypatch):
    """The library says nothing of it; only that nothing comes any more."""
    monkeypatch.setattr(live_source, "_MIN_SILENCE_S", 0.6)
    cameras = live("pymba:0")
    cameras.take(3)
    simulator.set(0, mute=1)
    frame = cameras.until(lambda one: one.left is None)[-1]
    assert frame.left_fault.reason is Reason.CAMERA_LOST and "has sent nothing" in frame.left_fault
    simulator.set(0, mute=0)
    cameras.until(lambda one: one.left is not None)
    # A machine that is busy for longer than this silence loses it once more.
    names = cameras.event_names
    assert names == [("camera_lost", "left"), ("camera_back", "left")] * (len(names) // 2)
    assert names and simulator.count(0, "starts") >= 2


def test_a_camera_that_is_waited_for(simulator, quick):
    simulator.set(1, plugged=0)
    cameras = quick(wait=True)
    frames = cameras.until(lambda frame: frame.right_fault.reason is Reason.CAMERA_LOST)
    simulator.set(1, plugged=1)
    check(frames + cameras.until(is_pair))
    assert cameras.event_names == [("camera_lost", "right"), ("camera_back", "right")]


def keepers() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if "camera" in thread.name]


def test_stop_while_streaming_and_while_lost(simulator):
    for plugged in (1, 0):
        simulator.set(1, plugged=1)
        source = open_camera_source(SourceConfig("pymba:0,1"), SYSTEM_CLOCK, lambda event: None)
        simulator.set(1, plugged=plugged)
        frames: list[Frame] = []
        reader = threading.Thread(target=lambda: frames.extend(source), daemon=True)  # noqa: B023
        reader.start()
        until(lambda: len(frames) >= 3)  # noqa: B023
        source.stop()
        reader.join(MAX_S)
        assert not reader.is_alive() and frames
        assert simulator.opened == [0, 0]
        assert keepers() == []


def test_a_driver_that_hangs_as_it_closes_a_lost_camera(simulator, live, monkeypatch):
    cameras = live("pymba:0")
    cameras.take(3)
    simulator.set(0, hangs_at_close=1, plugged=0)
    cameras.until(lambda frame: frame.left_fault.reason is Reason.CAMERA_LOST)
    monkeypatch.setattr(live_source, "HUNG_S", 0.5)
    words = refuses("camera 0 hangs: closing it", cameras.until, lambda frame: False)
    assert "only a new start frees it" in words
    simulator.set(0, hangs_at_close=0)
    until(lambda: not keepers())


def test_a_driver_that_hangs_as_it_opens_at_the_start(simulator, live, monkeypatch):
    live("pymba:0").source.close()
    simulator.set(0, hangs_at_open=1)
    monkeypatch.setattr(live_source, "HUNG_S", 0.3)
    refuses("camera 0 hangs: opening it", live, "pymba:0")
    # With one that is waited for the loop begins, and the other camera's frames come meanwhile.
    monkeypatch.setattr(live_source, "HUNG_S", MAX_S)
    waiting = live("pymba:1,0", wait=True)
    assert seen(waiting.take(1)[0].left)[0] == 1
    monkeypatch.setattr(live_source, "HUNG_S", 0.3)
    refuses("only a new start frees it", waiting.until, lambda frame: False)
    simulator.set(0, hangs_at_open=0)
    until(lambda: not keepers())


@pytest.fixture
def running(vimba_environment, bundle_file, receiver):
    """The command and the environment of `tokt run` on simulated cameras, with shorter limits."""

    def make(plan: str, **limits: float) -> tuple[list[str], dict[str, str]]:
        program = "import tokt.inference.sources.cameras.live_source as limits\n"
        program += "".join(f"limits.{name} = {value}\n" for name, value in limits.items())
        program += "from tokt.cli import main\nmain()\n"
        options = ["--source", "pymba:0", "--bundle", str(bundle_file), "--pixel-format", "Mono8"]
        options += ["--policy", "texture", "--udp", f"v2@127.0.0.1:{receiver.getsockname()[1]}"]
        environment = {**os.environ, **vimba_environment, "VIMBA_SIMULATOR": plan}
        return [sys.executable, "-P", "-c", program, "run", *options], environment

    return make


@pytest.mark.process
def test_a_driver_that_hangs_when_a_lost_camera_is_opened_again(running, receiver, monkeypatch):
    """In a process of its own, under the watchdog; the same camera opens for the next process."""
    plan = "cameras=1;rate=20;width=360;height=271;0.hangs_at_open=1;0.hangs_at_exit=1"
    command, environment = running(f"{plan};0.unplug_at_s=1;0.replug_at_s=1.2", HUNG_S=1.0)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    told: list[str] = []
    dog = Watchdog(command, told.append, Notifier(SYSTEM_CLOCK, {}))
    thread = threading.Thread(target=dog.run, daemon=True)
    thread.start()
    try:
        said = [decode(receiver.recv(4096))]
        # On a busy machine the next one may lose its camera before there is a frame.
        nothing = "no_frame", "camera_lost", "stale", "stalled"
        while sum(one["seq"] == 1 for one in said) < 2 or said[-1]["reason"] in nothing:
            said.append(decode(receiver.recv(4096)))
    finally:
        dog.stop()
        thread.join(MAX_S)
    again = [one["seq"] for one in said].index(1, 1)
    reasons = [one["reason"] for one in said]
    assert reasons[again - 1] == "camera_lost"
    lost = reasons[reasons.index("camera_lost") : again]
    assert {one["status"] for one in said[again - len(lost) : again]} == {-1}
    assert dog.restarts >= 1, told
    words = "unknown `camera_lost` for 40 s, then the program ends; a watchdog starts it again"
    hold_row("a camera's driver hangs when it is opened again, or closed", words, "restarts +1")


@pytest.mark.process
def test_a_camera_that_is_gone_when_the_run_is_started_again(running, receiver):
    """Said as unknown, where the first start is refused: nobody would say anything."""
    command, environment = running("cameras=0")
    first = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert first.returncode == 2 and "no camera '0'; found: none" in first.stderr
    with subprocess.Popen(command, env={**environment, RESTARTS_VARIABLE: "1"}) as process:
        while decode(receiver.recv(4096))["reason"] != "camera_lost":
            pass
        process.terminate()
        # The latter where the machine is too busy to end a process in a second.
        assert process.wait(MAX_S) in (0, -signal.SIGALRM)
    fault = "a camera is gone when the watchdog starts the run again"
    hold_row(fault, "unknown `camera_lost`, until it is back", "frames by reason: camera_lost")


@pytest.mark.process
def test_a_driver_that_hangs_at_the_end(running, receiver):
    command, environment = running("cameras=1;0.hangs_at_close=1;0.hangs_at_exit=1", _JOIN_S=0.2)
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        receiver.recv(4096)
        process.terminate()
        assert process.wait(MAX_S) == -signal.SIGALRM
        assert "frames in" in process.stderr.read()
    said = "the program ends all the same, within 10 s"
    hold_row("a camera's driver hangs at the end", said, "nothing")


def test_stop_without_a_reader(simulator):
    source = open_camera_source(SourceConfig("pymba:0"), SYSTEM_CLOCK, lambda event: None)
    source.close()
    assert list(source) == []


@pytest.mark.parametrize("count", [1, 4])
def test_buffers_that_a_driver_hands_out_again(count, simulator, quick):
    for text in ("pymba:0", "pymba:0,1"):
        cameras = quick(text)
        before = cameras.until(lambda frame: frame.left is not None)[-1]
        simulator.set(0, again=count)
        cameras.until(lambda frame: frame.left_fault.reason is Reason.STALE)
        frames = cameras.take(10)
        assert {frame.left_fault.reason for frame in frames} <= {Reason.STALE, Reason.UNPAIRED}
        simulator.set(0, again=0)
        frames += cameras.until(lambda frame: frame.left is not None)
        assert seen(frames[-1].left)[1] > seen(before.left)[1]
        assert cameras.source.counts[LEFT].incomplete > 0
        cameras.source.close()
    hold_row("buffers that a camera's driver hands out again", "unknown `stale`", "incomplete")


class HandDriver:
    """Delivers what a test gives it."""

    name, period_s, shared_clock, failures = "by hand", 0.05, False, 0

    def start(self, deliver: Deliver) -> None:
        self._deliver = deliver

    def give(self, frame_id: int, taken_s: float) -> None:
        picture = np.zeros((4, 4), np.uint8)
        self._deliver(Capture(0, frame_id, taken_s, SYSTEM_CLOCK.monotonic(), time.time(), picture))

    def stop(self) -> None: ...

    def lost(self) -> str:
        return ""


@pytest.fixture
def by_hand(monkeypatch):
    """What becomes of the captures of a driver: (whether judged, missed), by number and time."""
    monkeypatch.setattr(live_source, "_FIRST_SILENCE_S", MAX_S)
    monkeypatch.setattr(live_source, "_MIN_SILENCE_S", MAX_S)

    def give(captures: list[tuple[int, float]], ptp: bool = False) -> list[tuple[bool, int]]:
        driver = HandDriver()
        driver.shared_clock = ptp
        source = CameraSource([driver], SYSTEM_CLOCK, lambda event: None)
        source.start()
        reader, frames = iter(source), []
        for capture in captures:
            driver.give(*capture)
            frames.append(next(reader))
        source.close()
        assert all(frame.left_fault.reason in (Reason.OK, Reason.STALE) for frame in frames)
        return [(frame.left is not None, frame.missed) for frame in frames]

    return give


NO_TIME = math.nan


def run(number: int, taken_s: float, count: int) -> list[tuple[int, float]]:
    """Captures from this one on, 20 a second."""
    return [(number + n, taken_s + 0.05 * n) for n in range(count)]


@pytest.mark.parametrize(
    ("captures", "new"),
    [
        # A clock that was set back; and buffers from before, which are never that many.
        ([*run(1, 5.0, 2), *run(3, 1.0, 10)], "yy" + 8 * "n" + "yy"),
        (
            [*run(9, 5.0, 2), *run(1, 1.0, 8), (11, 5.1), *run(1, 1.0, 8)],
            "yy" + 8 * "n" + "y" + 8 * "n",
        ),
        # An old one now and then; numbers that count what is delivered.
        ([(1, 5.0), (2, 5.05), (3, 5.0), (4, 5.1), (5, 5.05), (6, 5.15)], "yynyny"),
        # A camera without a clock: its numbers, which wrap.
        ([(1, NO_TIME), (2, NO_TIME), (2, NO_TIME), (1, NO_TIME), (3, NO_TIME)], "yynny"),
        ([(65534, NO_TIME), (65535, NO_TIME), *run(1, NO_TIME, 9)], "yy" + 8 * "n" + "y"),
        # One without numbers as well: what it repeats is seen by its pictures only.
        ([(0, NO_TIME), (0, NO_TIME), (0, NO_TIME)], "yyy"),
        # One that does not count, with a clock; and a clock that stands still.
        ([(0, 5.0), (0, 5.05), (0, 5.1)], "yyy"),
        ([(1, 5.0), (2, 5.0), (3, 5.0)], "ynn"),
    ],
)
def test_numbers_and_times_that_run_backwards(captures, new, by_hand):
    assert "".join("ny"[judged] for judged, _ in by_hand(captures)) == new
    said = "unknown `stale`, until more run forward in a row than there are buffers (8)"
    hold_row("a camera's numbers or times run backwards", said, "incomplete")


def test_numbers_and_times_that_jump(by_hand):
    steady = run(1, 0.0, 12)
    # By their numbers 10^12 frames were left out; by the clock none was.
    frames = by_hand([*steady, *run(10**12, 0.6, 12)])
    assert all(judged for judged, _ in frames) and {missed for _, missed in frames[9:]} == {0}
    for ptp in (False, True):
        frames = by_hand([*steady, *run(13, 1e12, 12)], ptp)
        assert all(judged for judged, _ in frames) and frames[-1][1] == 0
        assert max(missed for _, missed in frames) <= MANY_MISSED
    said = "as without it; no count of what is missing goes over 10^6"
    hold_row("a camera's numbers or times jump ahead by 10^12", said, "left out")


def test_a_suspend_is_no_silence_of_a_camera(hand_clock):
    driver = BrokenDriver()
    source = CameraSource([driver], hand_clock, lambda event: None)
    (keeper,) = source._keepers
    for number in (1, 2, 3):
        hand_clock.suspend(60 * (number > 1))
        keeper._deliver(Capture(0, number, number / 10, hand_clock.now, 0.0, None))
        hand_clock.now += 0.1
    hand_clock.suspend(60)
    assert keeper._trouble() == ""
    hand_clock.now += live_source._MIN_SILENCE_S
    assert "camera broken has sent nothing for 1.1 s" in keeper._trouble()


class BrokenDriver:
    """Opens, and then turns out to have a mistake in it."""

    name, period_s, shared_clock, failures = "broken", None, False, 0
    stopped = False

    def start(self, deliver: Deliver) -> None:
        deliver(Capture(0, 1, 0.0, SYSTEM_CLOCK.monotonic(), time.time(), None))

    def stop(self) -> None:
        self.stopped = True

    def lost(self) -> str:
        raise KeyError("a mistake")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_mistake_in_a_driver_ends_the_source_and_is_not_passed_over():
    driver = BrokenDriver()
    source = CameraSource([driver], SYSTEM_CLOCK, lambda event: None)
    with pytest.raises(RuntimeError, match="nobody looks after the left camera"):
        list(source)
    assert driver.stopped
