"""The tally of a replay: how many verdicts are the same, and where they are not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tokt.inference.verdict import STATUS_WORDS

from .replay import CHANGED, NOT_SHOWN, Compared


@dataclass
class ReplayStretch:
    """Frames in a row that differ alike.

    Parameters
    ----------
    first, last : int
        Frame numbers.
    frames : int
    logged, replayed : (int, str)
        Status and reason, then and now.
    fields : list of str
        What differs in at least one of them.
    example : mapping
        Of the first frame: what differs, then and now.
    """

    first: int
    last: int
    frames: int
    logged: tuple[int, str]
    replayed: tuple[int, str]
    fields: list[str]
    example: dict[str, list[Any]]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form, statuses in words."""
        return {
            "first": self.first,
            "last": self.last,
            "frames": self.frames,
            "logged": {"status": STATUS_WORDS[self.logged[0]], "reason": self.logged[1]},
            "replayed": {"status": STATUS_WORDS[self.replayed[0]], "reason": self.replayed[1]},
            "fields": self.fields,
            "example": self.example,
        }


@dataclass
class Tally:
    """Counts over a replay's frames.

    Parameters
    ----------
    statuses : Counter of (int, int)
        Logged and replayed status of the frames that are compared.
    same, status_differs, figures_differ : int
        Compared frames with the same verdict to the last bit, with another status, and with the
        same status and another figure or word.
    not_compared : Counter of str
        Frames that are not, by why not.
    alike_all_the_same : int
        Those of them that came out the same.
    gaps : int
        Frames before which some are missing, of which nothing is known: lines that are lost, or
        frames that were not recorded.
    stretches : list of ReplayStretch
    """

    statuses: Counter[tuple[int, int]] = field(default_factory=Counter)
    same: int = 0
    status_differs: int = 0
    figures_differ: int = 0
    not_compared: Counter[str] = field(default_factory=Counter)
    alike_all_the_same: int = 0
    gaps: int = 0
    stretches: list[ReplayStretch] = field(default_factory=list)
    _open: bool = False

    @property
    def compared(self) -> int:
        """Frames that are compared."""
        return self.same + self.status_differs + self.figures_differ

    @property
    def agrees(self) -> bool:
        """Whether every picture is the one that was judged, and every verdict the same."""
        changed = self.not_compared[CHANGED] + self.not_compared[NOT_SHOWN]
        return self.compared == self.same and not changed

    def add(self, frame: Compared) -> None:
        """Count one frame."""
        self.gaps += not frame.logged.follows
        if frame.why_not or frame.replayed is None or frame.differs is None:
            self.not_compared[frame.why_not] += 1
            self.alike_all_the_same += frame.differs == ()
            self._open = False
            return
        then, now = frame.logged.verdict, frame.replayed
        self.statuses[then["status"], now["status"]] += 1
        if not frame.differs:
            self.same += 1
            self._open = False
            return
        if then["status"] != now["status"]:
            self.status_differs += 1
        else:
            self.figures_differ += 1
        self._stretch(frame, now, frame.differs)

    def _stretch(self, frame: Compared, now: Mapping[str, Any], differs: tuple[str, ...]) -> None:
        then, number = frame.logged.verdict, frame.logged.number
        ends = (then["status"], then["reason"]), (now["status"], now["reason"])
        newest = self.stretches[-1] if self._open else None
        if newest is not None and (newest.logged, newest.replayed) == ends:
            newest.last, newest.frames = number, newest.frames + 1
            newest.fields += [name for name in differs if name not in newest.fields]
            return
        # Decision values are hundreds of numbers: that they differ is enough here.
        example = {name: [then[name], now[name]] for name in differs if name in now}
        self.stretches.append(ReplayStretch(number, number, 1, *ends, list(differs), example))
        self._open = True

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            "same": self.agrees,
            "compared": self.compared,
            "same_to_the_bit": self.same,
            "status_differs": self.status_differs,
            "figures_differ": self.figures_differ,
            "not_compared": dict(self.not_compared),
            "not_compared_but_alike": self.alike_all_the_same,
            "gaps": self.gaps,
            "statuses": self.table(),
            "differences": [stretch.to_json() for stretch in self.stretches],
        }

    def table(self) -> dict[str, dict[str, int]]:
        """Frames by logged status, then by replayed status, in words."""
        return {
            word: {other: self.statuses[status, now] for now, other in STATUS_WORDS.items()}
            for status, word in STATUS_WORDS.items()
        }
