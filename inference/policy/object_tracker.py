"""Holding one named object from frame to frame: held, searched for, or lost.

::

    last centres ──> where it can be ──> the place most like it ──> like it enough? ──> HELD
    (a queue)        (px and size)       (LBP and Haralick,         nothing alike
                          ^               then pixel by pixel)      beside it?      ──> SEARCHING
                          └───── wider with every frame in which it is not seen ────────┘──> LOST

Held is only what was seen in this very frame. What is searched for has to be more like the object
than what is held, than all else in the picture, and than anything that was seen beside it before;
in `AGAIN` frames in a row. After `SEARCHED` frames it may be anything: a person names it anew.
"""

import math
from collections import deque
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from tokt.features.common.arrays import U8

from .object_model import SOUGHT, Likeness, ObjectModel, Place, Reach

Distance = Callable[[Place], float | None]
HELD, SEARCHING, LOST = "held", "searching", "lost"
STATES = (HELD, SEARCHING, LOST)

QUEUE = 5
"""Last centres that say where the next one is."""
STEP_PX, STEP_SIZE = 20.0, 0.12
"""Farther than this from there, beside twice its longest step of late, it cannot be in the next
frame; in pixels of a picture 360 wide, and of ln of the size."""
WIDENS_PX, WIDENS_SIZE = 4.0, 0.02
"""By which that grows with each frame in which it is not seen."""
MAX_PX, MAX_SIZE = 120.0, SOUGHT
AGAIN, SEARCHED = 3, 600
FINDS = 0.4
"""Held is what is more like the object than all else in the picture where it was named; found what
is so much of the way from there to 1."""
MATCH_HOLDS, MATCH_FINDS = 0.7, 0.87
"""Least correlation of its fine detail, which another of the same make does not have: half of the
variance, and more than such another one has (rendered towers, seeds from 1001: at most 0.84)."""
MATCH_LESS, MIN_MATCH = 0.1, 0.7
"""In water that lets less through it has to be as high as when it was held first, less so much."""
BESIDE, BESIDE_MATCH = 0.02, 0.1
"""By which what is found is more like the object than anything else in the picture, or has more of
its fine detail."""
RIVALS_EVERY = 8
"""Frames from one look at all else in the picture to the next, while it is held."""
SAME_THING = 0.35
"""Of ln of size times distance, which are a thing's own: another thing differs by more."""


class ObjectTracker:
    """One object, followed through the frames of one run in their order.

    `anywhere` says that it may be anywhere in the first frames: named in a picture that was not
    taken just before them. The model itself is never changed; what else looks like the object only
    raises what it takes to find it again.
    """

    def __init__(self, model: ObjectModel, anywhere: bool = False, unseen: int = 0) -> None:
        self.model = model
        self.state = SEARCHING
        self._centres: deque[Place] = deque([model.place], maxlen=QUEUE)
        self._alike = model.alike
        self._anywhere = anywhere
        self._unseen = unseen  # frames since it was held, or named
        self._found: list[Place] = []
        # When it was held first: ln of its size times its distance, correlations.
        self._own: list[float] = []
        self._matches: list[float] = []
        self._frames = 0

    def look(
        self, picture: U8 | None, missed: int = 0, distance: Distance = lambda _: None
    ) -> Place | None:
        """Where the object is in the next frame; None unless it is held.

        `missed` frames are missing before it; `distance` gives metres to what is at a place.
        """
        if self.state == LOST:
            return None
        place = None
        if picture is not None and self.model.fits(picture):
            likeness = Likeness(self.model, picture)
            if self.state == HELD and missed <= QUEUE:
                place = self._held(likeness, 1 + missed)
            else:
                self._unseen += missed
                place = self._sought(likeness)
        metres = None if place is None else distance(place)
        if place is None or not self._is_same(place, metres):
            return self._not_seen(1 + missed)
        return self._seen(place, metres)

    def _seen(self, place: Place, metres: float | None) -> Place | None:
        if self.state != HELD:
            self._found.append(place)
            if len(self._found) < AGAIN:
                self._unseen += 1
                return None
            self._centres = deque(self._found, maxlen=QUEUE)
            self.state, self._found, self._anywhere = HELD, [], False
        self._centres.append(place)
        self._unseen = 0
        if metres is not None and len(self._own) < QUEUE:
            self._own.append(place.size + math.log(metres))
        return place

    def _not_seen(self, frames: int) -> None:
        self.state, self._found = SEARCHING, []
        self._unseen += frames
        if self._unseen > SEARCHED and not self._anywhere:
            self.state = LOST

    def _held(self, likeness: Likeness, frames: int) -> Place | None:
        """The place that goes on from the last centres, if it is like the object."""
        last, steps = self._centres[-1], [_step(*pair) for pair in pairwise(self._centres)]
        x, y, size = np.mean(steps, axis=0) * frames
        longest = max(math.hypot(x, y) for x, y, _ in steps)
        about = Place(last.x + x, last.y + y, last.size + size, 1.0)
        px = min((STEP_PX + 2 * longest) * frames, MAX_PX)
        place = likeness.best(Reach(about, px, min(STEP_SIZE * frames, MAX_SIZE)))
        if place is None or place.likeness < self.model.alike:
            return None
        place, match = likeness.refined(place)
        if match < MATCH_HOLDS:
            return None
        if len(self._matches) < QUEUE:
            self._matches.append(match)
        self._frames += 1
        if self._frames % RIVALS_EVERY == 1:
            beside = likeness.best(without=place)
            self._alike = max(self._alike, -1.0 if beside is None else beside.likeness)
        return place

    def _sought(self, likeness: Likeness) -> Place | None:
        """The place that is surely the object, within reach of where it was."""
        px, size = STEP_PX + WIDENS_PX * self._unseen, STEP_SIZE + WIDENS_SIZE * self._unseen
        reach = Reach(self._centres[-1], min(px, MAX_PX), min(size, MAX_SIZE))
        place = likeness.best(None if self._anywhere else reach)
        if place is None or place.likeness < self._alike + FINDS * (1 - self._alike):
            return None
        beside = likeness.best(without=place)
        place, match = likeness.refined(place)
        if match < self._match_needed:
            return None
        alike = beside is not None and beside.likeness > place.likeness - BESIDE
        if beside is not None and alike and likeness.refined(beside)[1] > match - BESIDE_MATCH:
            return None
        if self._found:
            x, y, size = _step(self._found[-1], place)
            if math.hypot(x, y) > STEP_PX or abs(size) > STEP_SIZE:
                self._found = []
        return place

    @property
    def _match_needed(self) -> float:
        if len(self._matches) < QUEUE:
            return MATCH_FINDS
        return min(max(float(np.median(self._matches)) - MATCH_LESS, MIN_MATCH), MATCH_FINDS)

    def _is_same(self, place: Place, metres: float | None) -> bool:
        """Whether its size and its distance are those of the thing that was held first."""
        if metres is None or len(self._own) < QUEUE:
            return True
        return abs(place.size + math.log(metres) - float(np.median(self._own))) < SAME_THING


def _step(before: Place, after: Place) -> tuple[float, float, float]:
    return after.x - before.x, after.y - before.y, after.size - before.size
