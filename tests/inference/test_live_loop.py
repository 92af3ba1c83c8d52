"""The live loop: threads, a socket, and detectors that do what they should not."""

import threading
from typing import Any

import pytest

from tests.calls import refuses
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.outputs.udp import UdpSender, decode
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.reason import Reason
from tokt.inference.report import Event, Report
from tokt.inference.runtime import Runtime
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import CLEAR, Detection

from ..waiting import MAX_S, until
from .conftest import HandClock
from .live import HandSource, Listener, looping

QUICK = Limits(stale_s=0.15, heartbeat_s=0.15)


class Slow(TextureDetector):
    """Waits, before it judges a frame, until it is let go."""

    def __init__(self, scorer: Any) -> None:
        super().__init__(scorer)
        self.go = threading.Event()

    def detect(self, frame: Frame) -> Detection:
        self.go.wait(MAX_S)
        return super().detect(frame)


def silence(clock: HandClock, said: list[Any]) -> None:
    """Let time pass until one more report is said, which no frame is the reason for."""
    before = len(said)
    clock.now += 1.25 * QUICK.heartbeat_s
    until(lambda: len(said) > before)


def test_unknown_is_said_before_between_and_after_frames(
    noise_scorer, draw_frame, receiver, hand_clock
):
    source, listener = HandSource(hand_clock), Listener()
    sender = UdpSender(*receiver.getsockname(), 2)
    policy = SinglePolicy(TextureDetector(noise_scorer))
    runtime = Runtime(source, policy, [sender], hand_clock, [listener], QUICK)
    with looping(runtime) as ended:
        for _ in range(2):
            silence(hand_clock, listener.heartbeats)
        source.give(draw_frame([]))
        until(lambda: listener.reports)
        for _ in range(2):
            silence(hand_clock, listener.heartbeats)
    sender.close()
    heard = [decode(receiver.recv(65535)) for _ in range(sender.sent)]
    assert [one["seq"] for one in heard] == [1, 2, 3, 4, 5]
    assert [one["reason"] for one in heard] == ["no_frame", "no_frame", "ok", "stale", "stale"]
    assert all((one["status"] == CLEAR) == (one["reason"] == "ok") for one in heard)
    assert ended[0].heartbeats == 4 and ended[0].frames == 1


def test_a_loop_that_is_too_slow_judges_the_newest_frame(noise_scorer, draw_frame, hand_clock):
    source, slow, listener = HandSource(hand_clock), Slow(noise_scorer), Listener()
    runtime = Runtime(source, SinglePolicy(slow), [], hand_clock, [listener], Limits(60, 60))
    with looping(runtime) as ended:
        source.give(draw_frame([], 1))
        until(lambda: not slow.go.is_set() and runtime._publisher._judging_since is not None)
        for seed in range(2, 7):
            source.give(draw_frame([], seed))
        until(lambda: source.passed_on == 6)
        slow.go.set()
        until(lambda: len(listener.reports) == 2)
    assert [report.frame for report in listener.reports] == [1, 6]
    assert listener.frames[1].missed == 4 and listener.reports[1].left_out == 4
    assert listener.reports[1].verdict.reason is Reason.OVERLOAD
    assert (ended[0].dropped, ended[0].reasons["overload"]) == (4, 1)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_heartbeat_that_dies_ends_the_loop(noise_scorer, hand_clock):
    class Sender:
        sent = failed = 0

        def send(self, report: Report) -> None:
            raise TypeError("a mistake in a sender")

    policy = SinglePolicy(TextureDetector(noise_scorer))
    runtime = Runtime(HandSource(), policy, [Sender()], hand_clock, limits=QUICK)
    with looping(runtime) as ended:
        hand_clock.now += 1.25 * QUICK.heartbeat_s
        until(lambda: ended)
    assert isinstance(ended[0], RuntimeError) and "heartbeat" in str(ended[0])


def test_the_loop_shows_that_it_lives_and_does_what_is_to_be_done_between_frames(
    noise_scorer, hand_clock
):
    source, listener = HandSource(hand_clock), Listener()
    signs: list[str] = []
    rounds: list[str] = []
    to_tell = [Event(0.0, "model", "a new one")]

    def between() -> list[Event]:
        rounds.append(threading.current_thread().name)
        told, to_tell[:] = list(to_tell), []
        return told

    runtime = Runtime(
        *(source, SinglePolicy(TextureDetector(noise_scorer)), [], hand_clock, [listener]),
        between=between,
        alive=lambda: signs.append(threading.current_thread().name),
    )
    with looping(runtime):
        until(lambda: len(signs) >= 3)  # though no frame comes
        assert [event.name for event in listener.events] == ["model"]
    assert {*signs, *rounds} == {"the loop"}


@pytest.mark.parametrize("name", ["stale_s", "heartbeat_s", "frozen_repeats"])
def test_limits_are_positive(name):
    for value in (0, -1, float("nan"), float("inf")):
        refuses(name, Limits, **{name: value})
