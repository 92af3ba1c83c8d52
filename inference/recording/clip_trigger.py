"""A trigger for clips: the frames around a detection, and where the runtime had doubts.

::

    verdicts   . . . . . O O O . . . . . .      O obstacle, or another cause
    kept           b b b O O O a a a            b within before_s, a within after_s

A clip is what logs, metrics and ``recording.jsonl`` call a moment. An obstacle keeps it open. What
makes a frame unknown though there is a picture is a cause when it begins, and once a minute at
most; so is what the observers warn of (drift, a challenger that sees something else): a dark hour
on deck is one clip. After `MAX_S` at full rate, one frame a second is kept: an ROV can stand before
a wall for hours.
"""

from tokt.features.common.errors import ToktError
from tokt.inference.reason import Reason
from tokt.inference.verdict import OBSTACLE, UNKNOWN, Verdict

MAX_S = 30.0
THIN_S = 1.0
"""Seconds between frames that are kept of a clip longer than `MAX_S`."""
REST_S = 60.0
"""Seconds between clips of the same cause other than an obstacle."""

OBSTACLE_CAUSE = "obstacle"

DOUBTS = (
    *(Reason.DARK, Reason.SATURATED, Reason.BLANK, Reason.DAMAGED, Reason.BLURRED),
    Reason.VISIBILITY,
    Reason.WRONG_SIZE,
    *(Reason.DETECTOR_FAILED, Reason.NOT_FINITE, Reason.FRAME_RULE, Reason.STEREO, Reason.LATE),
    *(Reason.DRIFT, Reason.NOVEL, Reason.NO_COLOUR, Reason.SEDIMENT, Reason.MOVING),
)
"""Reasons for unknown whose picture a person learns something from."""


class ClipTrigger:
    """Decide frame by frame which ones belong to a clip.

    `clip` is the number of the present clip, or of the last one; 0 before the first. One that goes
    on for longer than `MAX_S` becomes the next. `opened` is whether it was the last frame looked at
    that opened it, for its `cause`.

    Frames are kept from `before_s` before a cause to `after_s` after it; ToktError where such a
    time is negative or longer than `MAX_S`.
    """

    def __init__(self, before_s: float, after_s: float) -> None:
        for name, value in (("before", before_s), ("after", after_s)):
            if not 0 <= value <= MAX_S:
                known = f"0 to {MAX_S:g} s {name} a detection"
                raise ToktError(f"frames are recorded for {known}, not {value:g}")
        self.clip = 0
        self.cause = ""
        self.opened = False
        self._after_s = after_s
        self._requested = ""
        self._until_s = self._began_s = self._kept_s = -float("inf")
        self._thin = False
        self._doubt: Reason | None = None
        self._last_s: dict[str, float] = {}

    def request(self, cause: str) -> None:
        """Open a clip at the next frame, if this cause has rested."""
        self._requested = cause

    def should_keep(self, now_s: float, verdict: Verdict) -> bool:
        """Whether to keep this frame; called for each frame in its turn.

        `now_s` is when it arrived, by a clock that never steps back.
        """
        cause = self._cause(now_s, verdict)
        within = now_s <= self._until_s
        self.opened = bool(cause) and not within
        if cause:
            self._until_s = max(self._until_s, now_s + self._after_s)
        if not within and not cause:
            return False
        if self.opened:
            self._begin(now_s, cause, thin=False)
        elif now_s - self._began_s > MAX_S:
            self._begin(now_s, self.cause, thin=True)
        if self._thin and now_s - self._kept_s < THIN_S:
            return False
        self._kept_s = now_s
        return True

    def _begin(self, now_s: float, cause: str, thin: bool) -> None:
        self.clip += 1
        self.cause, self._began_s, self._thin = cause, now_s, thin

    def _cause(self, now_s: float, verdict: Verdict) -> str:
        """Why this frame opens a clip, or keeps it open; empty where it does not."""
        before, self._doubt = self._doubt, None
        requested, self._requested = self._requested, ""
        if verdict.status == OBSTACLE:
            return OBSTACLE_CAUSE
        if verdict.status == UNKNOWN and verdict.reason in DOUBTS:
            self._doubt = verdict.reason
            if verdict.reason is not before and not requested:
                requested = verdict.reason.value
        if not requested or now_s - self._last_s.get(requested, -float("inf")) < REST_S:
            return ""
        self._last_s[requested] = now_s
        return requested
