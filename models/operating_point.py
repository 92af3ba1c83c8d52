"""The operating point: when a model's patches raise an alarm, and when alarms become a status.

Training chooses a rule for a stated rate of false statuses and the runtime applies it; both call
the functions here, so that the two cannot differ. What could not be judged is unknown: it never
counts as clear, and neither does a place where a frame is missing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..features.errors import ToktError

OBSTACLE, CLEAR, UNKNOWN = 1, 0, -1
"""The statuses, as datagrams carry them."""
LARGEST_WINDOW = 60
LARGEST_MARGIN = 1e9
"""Far beyond any decision value: a rule with a larger margin could never warn."""


@dataclass(frozen=True)
class FrameRule:
    """From the patches of the last frames to a status.

    A patch is *confirmed* when its obstacle score exceeded `margin` in at least `hits` of the
    last `window` frames: marine snow moves from frame to frame, what can be hit stays. The status
    is obstacle when at least `least_patches` patches are confirmed, and at once when a single
    patch of this frame exceeds `margin_now`. The default is the rule of L. S. Brusletto (NTNU
    2016): any one patch over its threshold.

    Parameters
    ----------
    margin : float
        0 to `LARGEST_MARGIN`, in units of the decision value, on top of the patch thresholds.
    least_patches : int
    hits, window : int
        1 <= hits <= window <= 60.
    margin_now : float or None
        `margin` to `LARGEST_MARGIN`; None where no patch is enough by itself.

    Raises
    ------
    ToktError
        If a number is out of its bounds.
    """

    margin: float = 0.0
    least_patches: int = 1
    hits: int = 1
    window: int = 1
    margin_now: float | None = None

    def __post_init__(self) -> None:
        if not (_is_number(self.margin) and 0 <= self.margin <= LARGEST_MARGIN):
            raise ToktError(
                f"a frame rule's margin is a number, 0 to {LARGEST_MARGIN:g}, not {self.margin!r}"
            )
        if not (_is_whole(self.least_patches) and self.least_patches >= 1):
            raise ToktError(f"a frame rule needs at least 1 patch, not {self.least_patches!r}")
        if not (
            _is_whole(self.hits)
            and _is_whole(self.window)
            and 1 <= self.hits <= self.window <= LARGEST_WINDOW
        ):
            raise ToktError(
                f"a frame rule asks for K of N frames, 1 <= K <= N <= {LARGEST_WINDOW}, "
                f"not {self.hits!r} of {self.window!r}"
            )
        now = self.margin_now
        if now is not None and not (_is_number(now) and self.margin <= now <= LARGEST_MARGIN):
            raise ToktError(
                f"a frame rule's margin for a status at once is null or a number, its margin "
                f"{self.margin:g} to {LARGEST_MARGIN:g}, not {now!r}"
            )

    @property
    def latency_frames(self) -> int:
        """Frames that the first status can come after a patch first exceeds the margin."""
        return self.hits - 1

    def words(self) -> str:
        """The rule in one line for people."""
        patches = "1 patch" if self.least_patches == 1 else f"{self.least_patches} patches"
        above = f" by more than {self.margin:.4g}" if self.margin else ""
        each = "the same patch" if self.least_patches == 1 else "each"
        frames = f"{each} in {self.hits} of {self.window} frames"
        text = (
            f"{patches} over the threshold{above}, {frames if self.window > 1 else 'in one frame'}"
        )
        return text if self.margin_now is None else f"{text}; or 1 by {self.margin_now:.4g} at once"

    def latency_words(self) -> str:
        """What the rule costs in time, for people."""
        if self.latency_frames == 0:
            return "the first alarm is a status at once"
        late = "1 frame" if self.latency_frames == 1 else f"{self.latency_frames} frames"
        text = f"a status comes {late} after a patch first exceeds the margin, at the earliest"
        return text if self.margin_now is None else f"{text}; at once above {self.margin_now:.4g}"

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Any) -> FrameRule:
        """Read back what `to_json` gave.

        Raises
        ------
        ToktError
            If it is not a rule.
        """
        names = {item.name for item in fields(cls)}
        if not isinstance(value, Mapping) or set(value) != names:
            raise ToktError(f"a frame rule has exactly {', '.join(sorted(names))}")
        return cls(**value)


@dataclass(frozen=True)
class OperatingPoint:
    """A rule, and how it was chosen.

    Parameters
    ----------
    rule : FrameRule
    chosen : mapping
        JSON: the stated rate, what the data showed of it and the bound it gives. Empty where
        nothing was chosen.
    """

    rule: FrameRule = field(default_factory=FrameRule)
    chosen: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form: the rule's fields and `chosen`."""
        return {**self.rule.to_json(), "chosen": dict(self.chosen)}

    @classmethod
    def from_json(cls, value: Any) -> OperatingPoint:
        """Read back what `to_json` gave.

        Raises
        ------
        ToktError
            If it is not an operating point.
        """
        if not isinstance(value, Mapping) or not isinstance(value.get("chosen"), Mapping):
            raise ToktError("an operating point is a frame rule with how it was chosen")
        rule = {name: part for name, part in value.items() if name != "chosen"}
        return cls(FrameRule.from_json(rule), value["chosen"])


def frame_step(numbers: Iterable[int]) -> int:
    """The step in which a mission counts its frames: the smallest difference between two."""
    ordered = sorted(set(numbers))
    return min((after - before for before, after in pairwise(ordered)), default=1)


def missed_before(numbers: Sequence[int], step: int) -> list[int]:
    """How many frames are missing before each of some frames.

    Parameters
    ----------
    numbers : sequence of int
        Rising frame numbers.
    step : int
        `frame_step` of their mission.
    """
    gaps = [(after - before) // step - 1 for before, after in pairwise(numbers)]
    return [0, *gaps] if numbers else []


class FrameRuleState:
    """Which patches exceeded the margin in the last frames of one run, and what that comes to.

    What was before the first frame is unknown, as a gap is.

    Parameters
    ----------
    rule : FrameRule
    """

    def __init__(self, rule: FrameRule) -> None:
        self.rule = rule
        self._last: deque[NDArray[np.bool_] | None] = deque([None] * rule.window, rule.window)

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """For each patch whether it is confirmed; empty before the first judged frame."""
        known = [over for over in self._last if over is not None]
        return np.asarray(np.sum(known, axis=0) >= self.rule.hits) if known else np.zeros(0, bool)

    def add(self, scores: NDArray[np.float64] | None, least_white: int = 1) -> int:
        """Take in the next frame and give its status.

        Parameters
        ----------
        scores : array of float64, shape (n_patches,), or None
            `LinearModel.obstacle_score` of the frame's patches; None where it was not judged.
        least_white : int
            Patches it takes to bring a mask's mean over the thesis's limit: 1, but for grids of
            very small patches.

        Returns
        -------
        {-1, 1, 0}
            Unknown where this frame was not judged; obstacle where the rule says so; unknown
            where it would say so if those of the last frames that are not known had shown what
            any of the known ones shows; else clear.
        """
        if scores is None:
            self._last.append(None)
            return UNKNOWN
        over = np.asarray(scores > self.rule.margin)
        self._last.append(over)
        needed = max(self.rule.least_patches, least_white)
        if np.count_nonzero(self.confirmed) >= needed or self._at_once(scores, least_white):
            return OBSTACLE
        known = [past for past in self._last if past is not None]
        times = np.sum(known, axis=0)
        possible = (times > 0) & (times + self.rule.window - len(known) >= self.rule.hits)
        return UNKNOWN if np.count_nonzero(possible) >= needed else CLEAR

    def skip(self, frames: int) -> None:
        """Leave out places where a frame is missing: they are not known."""
        self._last.extend([None] * min(frames, self.rule.window))

    def _at_once(self, scores: NDArray[np.float64], least_white: int) -> bool:
        now = self.rule.margin_now
        return now is not None and int(np.count_nonzero(scores > now)) >= least_white


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
