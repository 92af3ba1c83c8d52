"""Times of one kind, what is asked of them, and whether they keep to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

WORST = 100


@dataclass(frozen=True)
class Timing:
    """Times of one thing that a person waits for.

    Parameters
    ----------
    name : str
    what : str
        From when to when, in words.
    times_ms : sequence of float
    asked_ms : float or None
        The longest that is allowed; None where nothing is asked.
    percentile : int
        Which percentile of the times `asked_ms` is for; `WORST` means all of them.
    """

    name: str
    what: str
    times_ms: Sequence[float]
    asked_ms: float | None = None
    percentile: int = 95

    def at(self, percentile: int) -> float:
        """A percentile of the times, ms."""
        return float(np.percentile(self.times_ms, percentile))

    @property
    def holds(self) -> bool | None:
        """Whether it is as fast as asked; None where nothing is asked."""
        return None if self.asked_ms is None else self.at(self.percentile) <= self.asked_ms

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            "name": self.name,
            "what": self.what,
            "count": len(self.times_ms),
            "p50_ms": self.at(50),
            "p95_ms": self.at(95),
            "worst_ms": self.at(WORST),
            "asked_ms": self.asked_ms,
            "asked_of": "worst" if self.percentile == WORST else f"p{self.percentile}",
            "holds": self.holds,
        }
