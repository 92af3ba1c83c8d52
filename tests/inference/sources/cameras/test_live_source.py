"""Frames of two simulated cameras: true pairs, every fault with its reason, and never a hang."""

import functools
import threading
import time
from collections import Counter
from itertools import pairwise

import pytest

from tests.calls import refuses
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.reason import Reason
from tokt.inference.sources.cameras import live_source
from tokt.inference.sources.cameras.capture import Capture, Deliver
from tokt.inference.sources.cameras.live_source import CameraSource
from tokt.inference.sources.cameras.open import open_camera_source

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


def test_clocks_set_by_ptp_pair_from_the_first_frame(simulator, live):
    """However late the right camera's link is."""
    simulator.set(1, delay_s=0.015)
    cameras = live(ptp=True)
    check(cameras.until(is_pair) + cameras.take(10))


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
    figures = cameras.source.figures()["cameras"].values()
    assert min(figure["left_out"] for figure in figures) >= 3
    assert min(figure["unpaired"] for figure in figures) >= 3


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
    assert cameras.source.figures()["cameras"]["right"]["incomplete"] >= len(torn)


def test_a_reader_that_is_slow_gets_the_newest(simulator, quick):
    cameras = quick()
    last = cameras.until(is_pair)[-1]
    time.sleep(6 / RATE_HZ)  # 12 periods
    frames = cameras.until(is_pair)
    check([last, *frames])
    between = seen(frames[-1].left)[1] - seen(last.left)[1] - 1
    told = sum(frame.missed for frame in frames) + len(frames) - 1
    assert between >= 9 and told >= between
    assert cameras.source.overtaken >= 9


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
    assert cameras.source.figures()["cameras"]["left"]["lost"] == 1


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


def test_while_a_lone_camera_is_lost_frames_say_so_again_and_again(simulator, live):
    simulator.set(0, handle_dies=1)
    cameras = live("pymba:0")
    cameras.take(2)
    simulator.set(0, plugged=0)
    cameras.until(lambda frame: frame.left is None)
    start = time.monotonic()
    frames = cameras.take(3)
    assert time.monotonic() - start > 0.3
    assert {frame.left_fault.reason for frame in frames} == {Reason.CAMERA_LOST}
    assert len({frame.arrived for frame in frames}) == 3


def test_a_camera_that_is_not_there_at_the_start(simulator, live):
    for text, words in (("pymba:DEV_1", "no camera 'DEV_1'"), ("pymba:0,2", "no camera '2'")):
        refuses(words, live, text)
        assert simulator.opened == [0, 0]


def test_a_camera_that_is_waited_for(simulator, quick):
    simulator.set(1, plugged=0)
    cameras = quick(wait=True)
    frames = cameras.until(lambda frame: frame.right_fault.reason is Reason.CAMERA_LOST)
    simulator.set(1, plugged=1)
    check(frames + cameras.until(is_pair))
    assert cameras.event_names == [("camera_lost", "right"), ("camera_back", "right")]


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
        assert [thread for thread in threading.enumerate() if "camera" in thread.name] == []


def test_stop_without_a_reader(simulator):
    source = open_camera_source(SourceConfig("pymba:0"), SYSTEM_CLOCK, lambda event: None)
    source.close()
    assert list(source) == []


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
