"""A dive with a fault in it: a live loop, real sockets, and the truth about every frame."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.outputs.udp import UdpSender, decode
from tokt.inference.policy.policy import Policy, SinglePolicy
from tokt.inference.publisher import Observer, Sender
from tokt.inference.reason import NO_FAULT, Fault
from tokt.inference.report import Event, EventQueue
from tokt.inference.runtime import Runtime, Summary
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import CLEAR, STATUS_WORDS, UNKNOWN, Detection

from ..waiting import until
from .conftest import HandClock, NoiseScorer, draw
from .live import HandSource, Listener, bound_socket, looping

QUICK = Limits(stale_s=0.2, heartbeat_s=0.2)
_BETWEEN_FRAMES_S = 0.001


class Faulty(TextureDetector):
    """A detector that a test makes do what no detector should."""

    before: Callable[[Frame], None] = staticmethod(lambda frame: None)
    judging = False

    def detect(self, frame: Frame) -> Detection:
        self.judging = True
        try:
            self.before(frame)
            return super().detect(frame)
        finally:
            self.judging = False


@dataclass
class Outcome:
    """What was said of the frames, and that none was called clear wrongly.

    Parameters
    ----------
    said : list of (what, status, reason)
        `what` is the truth about the frame: ``clear``, ``obstacle``, ``fault``, or ``-`` for a
        heartbeat.
    events : list of Event
    summary : Summary
    """

    said: list[tuple[str, str, str]]
    events: list[Event]
    summary: Summary

    def of(self, what: str) -> set[tuple[str, str]]:
        """Status and reason of all frames of one kind."""
        return {(status, reason) for kind, status, reason in self.said if kind == what}


@dataclass
class Dive:
    """A loop that is fed by hand.

    Parameters
    ----------
    clock : HandClock
        Time passes only where a test says so: nothing is late because the machine is busy.
    limits : Limits
    """

    clock: HandClock = field(default_factory=HandClock)
    limits: Limits = QUICK
    scorer: Any = field(default_factory=NoiseScorer)
    senders: list[Sender] = field(default_factory=list)
    observers: list[Observer] = field(default_factory=list)
    between: Callable[[], Sequence[Event]] = tuple

    def __post_init__(self) -> None:
        self.source = HandSource(self.clock)
        self.events = EventQueue()
        self.listener = Listener()
        self.detector = Faulty(self.scorer)
        self.policy: Policy = SinglePolicy(self.detector)
        self.truth: dict[float, str] = {}
        self._heard = [bound_socket(), bound_socket()]
        self._own = [
            UdpSender(*heard.getsockname(), version)
            for version, heard in enumerate(self._heard, start=1)
        ]
        self._seed = 0
        self.delivered = 0
        self.ended: list[Any] = []

    def picture(self, what: str) -> NDArray[np.uint8]:
        """A new picture, of clear water or of something in it."""
        self._seed += 1
        picture = draw([(4, 4)] if what == "obstacle" else [], self._seed)
        # No two pictures of a camera are the same.
        picture[self._seed % 271, self._seed % 360] += 1
        return picture

    def give(self, what: str, left: NDArray[np.uint8] | None = None, **more: Any) -> None:
        """Deliver a frame of ``clear`` or ``obstacle``, or what a fault makes of it."""
        judged = len(self.listener.reports)
        picture = self.picture(what) if left is None and "left_fault" not in more else left
        self._deliver(what, picture, **more)
        self.until(lambda: len(self.listener.reports) > judged)

    def give_at_once(self, *what: str) -> None:
        """Deliver frames faster than they can be judged."""
        for one in what:
            self._deliver(one, self.picture(one))

    def _deliver(self, what: str, picture: NDArray[np.uint8] | None, **more: Any) -> None:
        self.clock.now += _BETWEEN_FRAMES_S
        frame = self.source.frame(picture, **more)
        self.truth[frame.t] = what
        self.delivered += 1
        self.source.deliver(frame)

    def pass_on(self) -> None:
        """Wait until all frames have come to the loop, or were overtaken before they could."""
        self.until(lambda: self.source.passed_on == self.delivered)

    def silence(self) -> None:
        """Let so much time pass, while no verdict is said, that unknown is."""
        with self.something_said():
            self.clock.now += 1.25 * self.limits.heartbeat_s

    @contextmanager
    def something_said(self) -> Iterator[None]:
        """Wait until more has been sent than before, by whichever thread."""
        sender = self._own[-1]
        sent = sender.sent
        yield
        self.until(lambda: sender.sent > sent)

    def fault(self, fault: Fault = NO_FAULT, **more: Any) -> None:
        """Deliver a frame without a picture."""
        self.give("fault", None, left_fault=fault, **more)

    def until(self, true: Callable[[], object]) -> None:
        until(true, lambda: self.listener.reports)

    @contextmanager
    def under_way(self) -> Iterator[None]:
        """Run the loop."""
        runtime = Runtime(
            *(self.source, self.policy, [*self.senders, *self._own], self.clock),
            observers=[*self.observers, self.listener],
            limits=self.limits,
            events=self.events,
            between=self.between,
        )
        with looping(runtime) as self.ended:
            yield
        for sender in self._own:
            sender.close()

    @contextmanager
    def fault_between(self) -> Iterator[None]:
        """Run the loop: a healthy stretch, what a test does to it, and a healthy one again."""
        with self.under_way():
            healthy(self)
            yield
            healthy(self)

    def outcome(self) -> Outcome:
        """What was heard; no datagram said clear but of a frame of clear water."""
        v1, said = [], []
        for heard, socket_, sender in zip((v1, said), self._heard, self._own, strict=True):
            with socket_:
                socket_.setblocking(False)
                heard += [decode(socket_.recv(65535)) for _ in range(sender.sent)]
        assert [one["seq"] for one in said] == list(range(1, len(said) + 1)), "a datagram was lost"
        heartbeats = {report.seq for report in self.listener.heartbeats}
        known = []
        for one in said:
            what = "-" if one["seq"] in heartbeats else self.truth[one["t"]]
            assert one["status"] != CLEAR or what == "clear", f"a wrong clear: {one}"
            assert one["status"] != UNKNOWN or one["reason"] != "ok"
            known.append((what, STATUS_WORDS[one["status"]], one["reason"]))
        # v1 says the same, and nothing where nothing is known.
        expected = Counter(one["status"] for one in said if one["status"] != UNKNOWN)
        assert Counter(one["status"] for one in v1) == expected
        (summary,) = self.ended
        assert isinstance(summary, Summary), summary  # the loop did not die of an error
        return Outcome(known, self.listener.events, summary)


def healthy(dive: Dive) -> None:
    """Clear water, and an obstacle, as they are seen without a fault."""
    dive.give("clear")
    dive.give("obstacle")
