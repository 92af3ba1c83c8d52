"""What somebody said between two looks at the store: the frames, by who said it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeAlias

from ..record import SETTLED

FrameName: TypeAlias = tuple[str, int]
"""Camera and number of a frame."""


@dataclass(frozen=True)
class Changed:
    """Frames in which something was said.

    Attributes
    ----------
    event : int
        The last event that is counted in.
    labelled, settled : dict of str to set of (camera, frame)
        Frames in which that annotator labelled, and in which that annotator settled something.
    since : int
        Events up to this one are not counted in.
    """

    event: int
    labelled: dict[str, set[FrameName]] = field(default_factory=dict)
    settled: dict[str, set[FrameName]] = field(default_factory=dict)
    since: int = 0

    def __bool__(self) -> bool:
        return bool(self.labelled or self.settled)

    @property
    def frames(self) -> set[FrameName]:
        """All of the frames."""
        return set().union(*self.labelled.values(), *self.settled.values())

    @property
    def annotators(self) -> set[str]:
        """Everybody who said something."""
        return {*self.labelled, *self.settled}

    def seen_by(self, who: str, blind: bool) -> Changed:
        """What `who` may hear of it: when `blind`, only what `who` labelled."""
        if not blind:
            return self
        mine = {who: self.labelled[who]} if who in self.labelled else {}
        return Changed(self.event, mine, since=self.since)

    def add(self, who: str, source: str, frames: Iterable[FrameName]) -> None:
        """Count in that `who` labelled or settled something in these frames."""
        said = self.settled if source == SETTLED else self.labelled
        said.setdefault(who, set()).update(frames)

    def merged(self, other: Changed) -> Changed:
        """Both together."""
        return Changed(
            max(self.event, other.event),
            _union(self.labelled, other.labelled),
            _union(self.settled, other.settled),
            min(self.since, other.since),
        )


def _union(a: dict[str, set[FrameName]], b: dict[str, set[FrameName]]) -> dict[str, set[FrameName]]:
    return {who: a.get(who, set()) | b.get(who, set()) for who in {*a, *b}}
