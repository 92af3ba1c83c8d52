"""The budget of a search: minutes, or trials."""

from __future__ import annotations

import re
from dataclasses import dataclass

from tokt.features.common.errors import ToktError

_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0}


@dataclass(frozen=True)
class Budget:
    """A limit on the trials begun in one run; None for no limit.

    Parameters
    ----------
    seconds : float or None
    trials : int or None
    """

    seconds: float | None = None
    trials: int | None = None


def budget_from(text: str | None) -> Budget:
    """Read ``30m``, ``2h``, ``90s`` (time) or ``12`` (trials).

    Raises
    ------
    ToktError
        If it is neither.
    """
    if text is None:
        return Budget()
    match = re.fullmatch(r"(\d{1,9})([smh]?)", text.strip(), re.ASCII)
    if match is None or int(match[1]) == 0:
        raise ToktError(f"budget {text!r}: write a time as 30m, 2h or 90s, or a number of trials")
    number, unit = int(match[1]), match[2]
    return Budget(seconds=number * _UNITS[unit]) if unit else Budget(trials=number)
