"""Links that fail, told while the run goes on: receivers that are refused, a place that is lost."""

from collections import Counter
from collections.abc import Callable, Mapping

from tokt.inference.clock import Clock
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer, Sender
from tokt.inference.report import Event, Report

REFUSED_S = 1.0
"""Seconds without a datagram that went out, after which a receiver's refusals are told."""


LOST_S = 5.0
"""Seconds without the vehicle's place after which that is told."""


class PlaceWatch(Observer):
    """Tell when the vehicle's place is doubtful or not known, and when it is known again.

    The events are ``place_doubtful``, ``place_lost`` and ``place_back``; `why` gives what its link
    complains of, if anything.
    """

    def __init__(
        self, clock: Clock, tell: Callable[[Event], None], why: Callable[[], str] = str
    ) -> None:
        self._clock, self._tell, self.why = clock, tell, why
        self._known_s = clock.monotonic()
        self._state = "place_back"

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Look at its place."""
        self.heartbeat(report)

    def heartbeat(self, report: Report) -> None:
        """Look at its place."""
        now, place, state = self._clock.monotonic(), report.place, self._state
        if place.doubt or place.age_ms is not None:
            self._known_s = now
            state = "place_doubtful" if place.doubt else "place_back"
        elif now - self._known_s >= LOST_S:
            state = "place_lost"
        if state != self._state:
            self._state = state
            parts = {
                "place_back": ["the vehicle's place is known again"],
                "place_doubtful": ["the vehicle's place is doubtful", place.doubt],
                "place_lost": ["the vehicle's place is not known", self.why()],
            }[state]
            self._tell(Event(self._clock.time(), state, ": ".join(filter(None, parts))))


class ReceiverWatch(Observer):
    """Tell when a receiver gets nothing any more as the system refuses it, and when it does again.

    The events are ``receiver_refused`` and ``receiver_back``; senders go by receiver.
    """

    def __init__(
        self, senders: Mapping[str, Sender], clock: Clock, tell: Callable[[Event], None]
    ) -> None:
        self._senders = senders
        self._clock = clock
        self._tell_event = tell
        # By receiver, of which one may be added at any time.
        self._sent: Counter[str] = Counter()
        self._failed: Counter[str] = Counter()  # up to when one last went out
        self._since: dict[str, float] = {}
        self._refused: set[str] = set()

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Look at every receiver."""
        self.heartbeat(report)

    def heartbeat(self, report: Report) -> None:
        """Look at every receiver."""
        now = self._clock.monotonic()
        for name, sender in self._senders.items():
            if sender.sent > self._sent[name]:
                self._sent[name], self._failed[name] = sender.sent, sender.failed
                self._since.pop(name, None)
                if name in self._refused:
                    self._refused.remove(name)
                    self._tell("receiver_back", name, f"{name} is sent to again")
            elif sender.failed > self._failed[name]:
                since = self._since.setdefault(name, now)
                if now - since >= REFUSED_S and name not in self._refused:
                    self._refused.add(name)
                    words = f"nothing can be sent to {name}: {sender.last_error}"
                    self._tell("receiver_refused", name, words)

    def _tell(self, event: str, name: str, words: str) -> None:
        self._tell_event(Event(self._clock.time(), event, words, {"receiver": name}))
