"""The live loop: threads, a socket, and detectors that do what they should not."""

import threading

import pytest

from tests.calls import refuses
from tokt.inference.config import Limits
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.report import Event, Report
from tokt.inference.runtime import Runtime
from tokt.inference.texture.detector import TextureDetector

from ..waiting import until
from .live import HandSource, Listener, looping

QUICK = Limits(stale_s=0.15, heartbeat_s=0.15)


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
