"""Findings: the lines of `tokt doctor` about an installation, a store or a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

OK, NOTE, FAULT = "ok", "note", "fault"


@dataclass(frozen=True)
class Finding:
    """One line of `tokt doctor`.

    Parameters
    ----------
    name : str
        What was looked at.
    state : {"ok", "note", "fault"}
        A note is worth knowing and may be as intended; a fault keeps something from working.
    text : str
        What was found, for people.
    figures : dict
        The same for scripts, as JSON values.
    """

    name: str
    state: str
    text: str
    figures: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {**self.figures, "name": self.name, "state": self.state, "text": self.text}
