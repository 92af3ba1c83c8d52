"""The loop in real time: threads, a socket, and detectors that do what they should not."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.detector import Detection, GridDetector
from tokt.inference.limits import Limits
from tokt.inference.observer import Event
from tokt.inference.policy import SinglePolicy
from tokt.inference.reason import Reason
from tokt.inference.report import Report
from tokt.inference.runtime import Runtime
from tokt.inference.sources import Frame
from tokt.inference.udp import UdpSender, decode
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

from .live import HandSource, Listener

Draw = Callable[..., np.ndarray]
QUICK = Limits(stale_s=0.15, heartbeat_s=0.15)


class Slow(GridDetector):
    """Waits, before it judges a frame, until it is let go."""

    def __init__(self, scorer: Any) -> None:
        super().__init__(scorer)
        self.go = threading.Event()

    def detect(self, frame: Frame) -> Detection:
        self.go.wait(5)
        return super().detect(frame)


def run(runtime: Runtime) -> tuple[threading.Thread, list[Any]]:
    """Start a runtime in a thread; its summary, or what it raised, is the list's only item."""
    ended: list[Any] = []

    def go() -> None:
        try:
            ended.append(runtime.run())
        except RuntimeError as error:
            ended.append(error)

    thread = threading.Thread(target=go)
    thread.start()
    return thread, ended


def until(true: Callable[[], object]) -> None:
    """Wait until something is true."""
    deadline = time.monotonic() + 5
    while not true():
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(0.002)


def test_unknown_is_said_before_between_and_after_frames(
    noise_scorer: Any, draw_frame: Draw, receiver: Any
) -> None:
    source, listener = HandSource(), Listener()
    sender = UdpSender(*receiver.getsockname(), 2)
    policy = SinglePolicy(GridDetector(noise_scorer))
    runtime = Runtime(source, policy, [sender], SYSTEM_CLOCK, [listener], QUICK)
    thread, ended = run(runtime)
    until(lambda: len(listener.heartbeats) >= 2)
    source.give(draw_frame([]))
    until(lambda: len(listener.reports) == 1)
    until(lambda: len(listener.heartbeats) >= 4)
    source.stop()
    thread.join()
    sender.close()
    heard = [decode(receiver.recv(65535)) for _ in range(sender.sent)]
    assert [one["seq"] for one in heard] == list(range(1, len(heard) + 1))
    assert [one["reason"] for one in heard].count("ok") == 1
    assert {one["reason"] for one in heard} == {"no_frame", "ok", "stale"}
    assert all((one["status"] == CLEAR) == (one["reason"] == "ok") for one in heard)
    assert ended[0].heartbeats == len(heard) - 1 and ended[0].frames == 1


def test_a_detector_that_hangs_is_told_of_and_its_late_clear_is_not_believed(
    noise_scorer: Any, draw_frame: Draw
) -> None:
    source, slow = HandSource(), Slow(noise_scorer)
    said: list[Report] = []

    class Sender:
        sent = failed = 0

        def send(self, report: Report) -> None:
            said.append(report)

    runtime = Runtime(source, SinglePolicy(slow), [Sender()], SYSTEM_CLOCK, limits=QUICK)
    thread, _ = run(runtime)
    source.give(draw_frame([]))
    until(lambda: [one.verdict.reason for one in said].count(Reason.STALLED) >= 2)
    slow.go.set()
    until(lambda: Reason.LATE in [one.verdict.reason for one in said])
    source.give(draw_frame([(1, 1)]))
    until(lambda: OBSTACLE in [one.verdict.status for one in said])
    source.stop()
    thread.join()
    assert CLEAR not in [one.verdict.status for one in said]


def test_a_loop_that_is_too_slow_judges_the_newest_frame(
    noise_scorer: Any, draw_frame: Draw
) -> None:
    source, slow, listener = HandSource(), Slow(noise_scorer), Listener()
    runtime = Runtime(source, SinglePolicy(slow), [], SYSTEM_CLOCK, [listener], Limits(60, 60))
    thread, ended = run(runtime)
    source.give(draw_frame([], 1))
    until(lambda: not slow.go.is_set() and runtime._announcer._taken_up is not None)
    for seed in range(2, 7):
        source.give(draw_frame([], seed))
    until(lambda: source._frames.empty())
    slow.go.set()
    until(lambda: len(listener.reports) == 2)
    source.stop()
    thread.join()
    assert [report.frame for report in listener.reports] == [1, 6]
    assert listener.frames[1].missed == 4 and listener.reports[1].left_out == 4
    assert listener.reports[1].verdict.reason is Reason.OVERLOAD
    assert (ended[0].dropped, ended[0].reasons["overload"]) == (4, 1)


def test_a_frame_that_waited_too_long_is_stale(noise_scorer: Any, draw_frame: Draw) -> None:
    source, listener = HandSource(), Listener()
    policy = SinglePolicy(GridDetector(noise_scorer))
    thread, _ = run(Runtime(source, policy, [], SYSTEM_CLOCK, [listener]))
    source.give(draw_frame([]), age_s=0.7)
    until(lambda: listener.reports)
    source.stop()
    thread.join()
    verdict = listener.reports[0].verdict
    assert (verdict.status, verdict.reason) == (UNKNOWN, Reason.STALE)


def test_a_source_that_dies_ends_the_loop_with_its_error(
    noise_scorer: Any, draw_frame: Draw
) -> None:
    source, listener = HandSource(), Listener()
    policy = SinglePolicy(GridDetector(noise_scorer))
    thread, ended = run(Runtime(source, policy, [], SYSTEM_CLOCK, [listener]))
    source.give(draw_frame([]))
    source.fail(RuntimeError("the driver died"))
    thread.join(5)
    assert isinstance(ended[0], RuntimeError) and len(listener.reports) == 1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_heartbeat_that_dies_ends_the_loop(noise_scorer: Any) -> None:
    class Sender:
        sent = failed = 0

        def send(self, report: Report) -> None:
            raise TypeError("a mistake in a sender")

    policy = SinglePolicy(GridDetector(noise_scorer))
    thread, ended = run(Runtime(HandSource(), policy, [Sender()], SYSTEM_CLOCK, limits=QUICK))
    thread.join(5)
    assert isinstance(ended[0], RuntimeError) and "heartbeat" in str(ended[0])


def test_the_loop_shows_that_it_lives_and_does_what_is_to_be_done_between_frames(
    noise_scorer: Any, draw_frame: Draw
) -> None:
    source, listener = HandSource(), Listener()
    signs: list[float] = []
    to_tell = [Event(0.0, "model", "a new one")]

    def between() -> list[Event]:
        assert threading.current_thread() is thread
        told, to_tell[:] = list(to_tell), []
        return told

    runtime = Runtime(
        source,
        SinglePolicy(GridDetector(noise_scorer)),
        [],
        SYSTEM_CLOCK,
        [listener],
        between=between,
        alive=lambda: signs.append(time.monotonic()),
    )
    thread, _ = run(runtime)
    until(lambda: len(signs) >= 3)  # though no frame comes
    assert [event.name for event in listener.events] == ["model"]
    source.stop()
    thread.join()


@pytest.mark.parametrize("name", ["stale_s", "heartbeat_s", "frozen_repeats"])
@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf")])
def test_limits_are_positive(name: str, value: float) -> None:
    from tokt.features.errors import ToktError

    with pytest.raises(ToktError, match=name):
        Limits(**{name: value})
