"""Input drift: whether the frames of a run still look like those that the model learnt from.

A monitor counts the features of the last frames into the bins of the training distribution that
the bundle holds, and tells when one is further from training than any stretch of training frames
was from the others (`tokt.models.distribution`). It looks on: what one frame's distances mean for
its verdict is the texture detector's.

What it cannot see: frames that could not be judged (they have a reason of their own), what the
extractor does not look at (a model whose features keep their values in other light is right in not
minding other light), and a change of few patches among the many of a window.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tokt.features.common.arrays import F64, I64
from tokt.inference.publisher import Observer
from tokt.inference.report import Event
from tokt.models.distribution import BINS, Distribution, bin_counts

if TYPE_CHECKING:
    from tokt.inference.frame import Frame
    from tokt.inference.policy.policy import Judgement
    from tokt.inference.report import Report
    from tokt.models.bundle.bundle import Bundle

BACK_RATIO = 0.9
"""Part of its limit that every distance must come back under before drift is over: what lies on
the limit does not tell again and again."""
LOOKS_A_WINDOW = 4
"""How often distances are computed while a window's frames are exchanged."""
MAX_WORST = 5
"""Features that an event names."""


@dataclass(frozen=True)
class DriftState:
    """The drift at this moment."""

    known: bool = False  # whether the bundle holds a training distribution
    out: bool = False  # whether drift was told and is not over
    distance: float | None = None  # of the feature furthest out, 0..1; None before a full window
    limit: float | None = None  # where it is out of range


class DriftMonitor(Observer):
    """Watch the features of the last judged frames.

    `state` and `distances` are exchanged whole, so that another thread may read them. `tell` takes
    the events ``drift`` and ``drift_over``, of the thread that calls `judged`.
    """

    def __init__(self, tell: Callable[[Event], None]) -> None:
        self._tell = tell
        self._t, self._label = 0.0, ""
        self.state = DriftState()
        self.set_model(None)

    def set_model(self, model: Bundle | None) -> None:
        """Begin anew with another model, or with none; what was told of the last one is over."""
        if self.state.out:
            words = "another model: whether frames are like its training is not known yet"
            self._tell(Event(self._t, "drift_over", words, {"model": self._label}))
        self._t = 0.0
        self._label = "" if model is None else model.label
        self._distribution = None if model is None else model.distribution
        self._names = () if model is None else model.extractor.names
        self._window: deque[I64] = deque()
        self._since_look = 0
        self.distances: Mapping[str, float] = {}
        self.state = DriftState(known=self._distribution is not None)
        if self._distribution is not None:
            self._sum = np.zeros((self._distribution.dim, BINS), np.int64)
            self._limits = self._distribution.limits

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Take a frame's features into the window; where it is time, compare."""
        distribution, features = self._distribution, judgement.features
        if distribution is None or features is None or features.shape[1:] != (distribution.dim,):
            return
        self._t = frame.t
        counts = judgement.counts
        if counts is None:
            counts = bin_counts(features, distribution.edges)
        self._window.append(counts)
        self._sum += counts
        if len(self._window) > distribution.window_frames:
            self._sum -= self._window.popleft()
        self._since_look += 1
        full = len(self._window) == distribution.window_frames
        if full and self._since_look * LOOKS_A_WINDOW >= distribution.window_frames:
            self._since_look = 0
            self._look(distribution)

    def _look(self, distribution: Distribution) -> None:
        """Compare the window with training, and tell what has changed."""
        distances = distribution.distances(self._sum)
        ratios = distances / self._limits
        worst = int(ratios.argmax())
        was_out, ratio = self.state.out, float(ratios[worst])
        out = ratio > (BACK_RATIO if was_out else 1.0)
        self.distances = dict(zip(self._names, distances.tolist(), strict=True))
        self.state = DriftState(True, out, float(distances[worst]), float(self._limits[worst]))
        if out != was_out:
            self._tell(self._event(out, distances, ratios))

    def _event(self, out: bool, distances: F64, ratios: F64) -> Event:
        worst = [
            {
                "feature": self._names[index],
                "distance": float(distances[index]),
                "limit": float(self._limits[index]),
            }
            for index in np.argsort(-ratios, kind="stable")[:MAX_WORST].tolist()
        ]
        over = int(np.count_nonzero(ratios > 1))
        fields: dict[str, Any] = {
            "model": self._label,
            "frames": len(self._window),
            "features": len(ratios),
            "features_out": over,
            "worst": worst,
        }
        first = worst[0]
        figures = f"{first['feature']} {first['distance']:.2f}, limit {first['limit']:.2f}"
        if not out:
            words = f"the last {len(self._window)} frames are like training again ({figures})"
            return Event(self._t, "drift_over", words, fields)
        words = (
            f"the last {len(self._window)} frames are unlike what {self._label} learnt from: "
            f"{over} of {len(ratios)} features out of range ({figures})"
        )
        return Event(self._t, "drift", words, fields)
