"""The operating point: when a model's patches raise an alarm, and when alarms become a status.

Training chooses a rule for a stated rate of false statuses and the runtime applies it; both call
the functions here, so that the two cannot differ. What could not be judged is unknown: it never
counts as clear, and neither does a place where a frame is missing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import ToktError

from .water import WaterPrior

OBSTACLE, CLEAR, UNKNOWN = 1, 0, -1
"""The statuses, as datagrams carry them."""
MAX_WINDOW = 60
MAX_MARGIN = 1e9
"""Far beyond any decision value: a rule with a larger margin could never warn."""

_JSON_NAMES = {
    "margin": "margin",
    "least_patches": "min_patches",
    "hits": "m",
    "window": "n",
    "margin_now": "instant_margin",
}
"""A rule's fields as bundles, logs and comparisons write them, which never change."""


@dataclass(frozen=True)
class MofNRule:
    """From the patches of the last frames to a status.

    A patch is *confirmed* when its obstacle score exceeded `margin` in at least `m` of the
    last `n` frames: marine snow moves from frame to frame, what can be hit stays. The status is
    obstacle when at least `min_patches` patches are confirmed, and at once when a single patch of
    this frame exceeds `instant_margin`. The default is the rule of L. S. Brusletto (NTNU
    2016): any one patch over its threshold.

    Raises ToktError if a number is out of its bounds.
    """

    margin: float = 0.0  # 0 to `MAX_MARGIN`, in decision values on top of the patch thresholds
    min_patches: int = 1
    m: int = 1  # 1 <= m <= n <= 60
    n: int = 1
    instant_margin: float | None = None  # `margin` to `MAX_MARGIN`; None: no patch alone is enough

    def __post_init__(self) -> None:
        if not (_is_number(self.margin) and 0 <= self.margin <= MAX_MARGIN):
            known = f"a number, 0 to {MAX_MARGIN:g}"
            raise ToktError(f"a frame rule's margin is {known}, not {self.margin!r}")
        if not (_is_whole(self.min_patches) and self.min_patches >= 1):
            raise ToktError(f"a frame rule needs at least 1 patch, not {self.min_patches!r}")
        if not (_is_whole(self.m) and _is_whole(self.n) and 1 <= self.m <= self.n <= MAX_WINDOW):
            known = f"K of N frames, 1 <= K <= N <= {MAX_WINDOW}"
            raise ToktError(f"a frame rule asks for {known}, not {self.m!r} of {self.n!r}")
        now = self.instant_margin
        if now is not None and not (_is_number(now) and self.margin <= now <= MAX_MARGIN):
            known = f"null or a number, its margin {self.margin:g} to {MAX_MARGIN:g}"
            raise ToktError(f"a frame rule's margin for a status at once is {known}, not {now!r}")

    @property
    def latency_frames(self) -> int:
        """Frames that the first status can come after a patch first exceeds the margin."""
        return self.m - 1

    def words(self) -> str:
        """The rule in one line for people."""
        patches = "1 patch" if self.min_patches == 1 else f"{self.min_patches} patches"
        above = f" by more than {self.margin:.4g}" if self.margin else ""
        each = "the same patch" if self.min_patches == 1 else "each"
        frames = f"{each} in {self.m} of {self.n} frames"
        text = f"{patches} over the threshold{above}, {frames if self.n > 1 else 'in one frame'}"
        now = self.instant_margin
        return text if now is None else f"{text}; or 1 by {now:.4g} at once, in its first frame"

    def latency_words(self) -> str:
        """What the rule costs in time, for people."""
        if self.latency_frames == 0:
            return "the first alarm is a status at once"
        late = "1 frame" if self.latency_frames == 1 else f"{self.latency_frames} frames"
        text = f"a status comes {late} after a patch first exceeds the margin, at the earliest"
        now = self.instant_margin
        return text if now is None else f"{text}; in that very frame above {now:.4g}"

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {name: getattr(self, attribute) for name, attribute in _JSON_NAMES.items()}

    @classmethod
    def from_json(cls, value: Any) -> MofNRule:
        """Read back what `to_json` gave; ToktError if it is not a rule."""
        if not isinstance(value, Mapping) or set(value) != set(_JSON_NAMES):
            raise ToktError(f"a frame rule has exactly {', '.join(sorted(_JSON_NAMES))}")
        return cls(**{_JSON_NAMES[name]: part for name, part in value.items()})


@dataclass(frozen=True)
class OperatingPoint:
    """A rule, and how it was chosen."""

    rule: MofNRule = field(default_factory=MofNRule)
    # JSON: the stated rate, what the data showed of it and the bound it gives; or empty.
    chosen: Mapping[str, Any] = field(default_factory=dict)
    water: WaterPrior | None = None  # None where the boundary does not move with the water
    # The distance to the nearest landmark above which no clear patch is believed
    # (`NystroemMap.distance`); None without a map.
    unlike: float | None = None

    def __post_init__(self) -> None:
        if self.unlike is not None and not (
            _is_number(self.unlike) and 0 < self.unlike < MAX_MARGIN
        ):
            raise ToktError(f"a distance to landmarks is above 0, not {self.unlike!r}")

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form: the rule's fields, `chosen`, and what else there is."""
        water = {} if self.water is None else {"water": self.water.to_json()}
        unlike = {} if self.unlike is None else {"unlike": self.unlike}
        return {**self.rule.to_json(), "chosen": dict(self.chosen), **water, **unlike}

    @classmethod
    def from_json(cls, value: Any) -> OperatingPoint:
        """Read back what `to_json` gave; ToktError if it is not an operating point."""
        if not isinstance(value, Mapping) or not isinstance(value.get("chosen"), Mapping):
            raise ToktError("an operating point is a frame rule with how it was chosen")
        rest = dict(value)
        chosen, unlike = rest.pop("chosen"), rest.pop("unlike", None)
        water = WaterPrior.from_json(rest.pop("water")) if "water" in rest else None
        return cls(MofNRule.from_json(rest), chosen, water, unlike)


def frame_step(numbers: Iterable[int]) -> int:
    """The step in which a mission counts its frames: the smallest difference between two."""
    ordered = sorted(set(numbers))
    return min((after - before for before, after in pairwise(ordered)), default=1)


def missed_before(numbers: Sequence[int], step: int) -> list[int]:
    """How many frames are missing before each of some; `step` is their mission's `frame_step`."""
    gaps = [(after - before) // step - 1 for before, after in pairwise(numbers)]
    return [0, *gaps] if numbers else []


class MofNState:
    """Which patches exceeded the margin in the last frames of one run, and what that comes to.

    What was before the first frame is unknown, as a gap is.
    """

    def __init__(self, rule: MofNRule) -> None:
        self.rule = rule
        self._last: deque[Bools | None] = deque([None] * rule.n, rule.n)

    @property
    def confirmed(self) -> Bools:
        """For each patch whether it is confirmed; empty before the first judged frame."""
        known = [over for over in self._last if over is not None]
        return np.asarray(np.sum(known, axis=0) >= self.rule.m) if known else np.zeros(0, bool)

    def add(self, scores: F64 | None, min_mask_patches: int = 1) -> int:
        """Take in the next frame and give its status.

        Parameters
        ----------
        scores : array of float64, shape (n_patches,), or None
            `LinearModel.obstacle_score` of the frame's patches; None where it was not judged.
        min_mask_patches : int
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
        needed = max(self.rule.min_patches, min_mask_patches)
        now = self.rule.instant_margin
        at_once = now is not None and np.count_nonzero(scores > now) >= min_mask_patches
        known = [past for past in self._last if past is not None]
        times = np.sum(known, axis=0)
        if at_once or np.count_nonzero(times >= self.rule.m) >= needed:
            return OBSTACLE
        possible = (times > 0) & (times + self.rule.n - len(known) >= self.rule.m)
        return UNKNOWN if np.count_nonzero(possible) >= needed else CLEAR

    def skip(self, frames: int) -> None:
        """Leave out places where a frame is missing: they are not known."""
        self._last.extend([None] * min(frames, self.rule.n))

    def begin(self, missed: int) -> None:
        """The next frame, `missed` frames after the one before; not known unless `judge` is."""
        self.skip(missed + 1)

    def judge(self, scores: F64, min_mask_patches: int = 1) -> int:
        """As `add`, of the frame that was begun."""
        self._last.pop()
        return self.add(scores, min_mask_patches)

    def doubt(self) -> None:
        """Where the last frame shows nothing, that is not believed: it is not known."""
        last = self._last[-1]
        if last is not None and not last.any():
            self._last[-1] = None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
