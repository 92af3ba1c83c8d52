"""Words for the pilot's screen: one line of text for each change of the verdict."""

import math

from tokt.inference.reason import Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, Verdict

MAX_TEXT = 50
"""Characters of MAVLink's STATUSTEXT."""
BETWEEN_S = 2.0
"""Between two lines, as a voice needs it; an obstacle that is news does not wait."""
_ASIDE = 1 / 6  # of the picture's width: a centre that is farther from the middle is left or right
ENDED = "tokt: ended, it warns no more"


def text_of(verdict: Verdict) -> str:
    """The line of a verdict, in ASCII and not longer than `MAX_TEXT`."""
    if verdict.status == CLEAR:
        return "tokt: clear"
    if verdict.status == UNKNOWN:
        return f"tokt: unknown, {verdict.reason.value.replace('_', ' ')}"[:MAX_TEXT]
    words = f"tokt: obstacle {_side(verdict)}"
    if verdict.distance_m is not None and 0 <= verdict.distance_m < math.inf:
        words += f", {min(verdict.distance_m, 999.0):.1f} m"
    return words


def _side(verdict: Verdict) -> str:
    """Where an obstacle is; x is the way to steer, which is the other one."""
    if verdict.x is None or verdict.mask_size is None:
        return "in view"
    aside = verdict.x / verdict.mask_size[1]
    if abs(aside) <= _ASIDE:
        return "ahead"
    return "on the left" if aside > 0 else "on the right"


class PilotWords:
    """Tell changes, at most one in `BETWEEN_S` besides an obstacle, at last always the newest."""

    def __init__(self) -> None:
        self._told: tuple[int | None, Reason | None] = (None, None)
        self._told_s = -math.inf
        self._again = False

    def tell_again(self) -> None:
        """Somebody new may listen: the next line is due though nothing changes."""
        self._again = True

    def due(self, verdict: Verdict, now: float) -> str | None:
        """The line that is to be told now, by a clock that never steps back, or None."""
        state = (verdict.status, verdict.reason if verdict.status == UNKNOWN else None)
        if state == self._told and not self._again:
            return None
        is_news = verdict.status == OBSTACLE and self._told[0] != OBSTACLE
        if now - self._told_s < BETWEEN_S and not is_news:
            return None
        self._told, self._told_s, self._again = state, now, False
        return text_of(verdict)
