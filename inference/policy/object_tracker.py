"""Holding one named object from frame to frame: held, searched for, or lost.

Held is only what was seen in this very frame, near where the last centres lead to. What is searched
for longer than `QUEUE` frames, in a reach that widens, has to match better than what is held, than
all else there, and in `AGAIN` frames in a row. After `SEARCHED` frames it may be anything: a person
names it anew.
"""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from tokt.features.common.arrays import U8, median
from tokt.features.extractors.frame_pictures import SharedPictures
from tokt.inference.frame import shape_fault

from .object_model import ObjectModel, ObjectPlace, detail_picture

HELD, SEARCHING, LOST = "held", "searching", "lost"

QUEUE = 5
"""Last centres that say where the next one is."""
STEP_PX, STEP_SIZE = 20.0, 0.12
"""Farther than this from there, beside twice its longest step of late, it cannot be in the next
frame; in pixels of a picture 360 wide, and of ln of the size."""
WIDENS_PX, WIDENS_SIZE = 4.0, 0.02
"""By which that grows with each frame in which it is not seen."""
AGAIN, SEARCHED = 3, 600
"""Frames in a row in which it is found before it is held, and in which it is searched for."""
MATCH_HOLDS, MATCH_FINDS, MATCH_FALLS = 0.7, 0.91, 0.05
"""Least correlation of its fine detail: half of the variance; more than another one of the same
make has (of 300 rendered towers, seeds from 1001, at most 0.897); how far it falls in a frame."""
BESIDE = 0.1
"""By which what is found matches better than anything else within reach."""
TEXTURE = 0.4
"""Least likeness of the texture: rendered objects have 0.8 or more, real ones had 0.47."""
SAME_THING = 0.35
"""Of ln of size times distance, which are a thing's own: another thing differs by more."""


class ObjectTracker:
    """One object, followed through the frames of one run in their order.

    In the first frames it may be anywhere: it was named in an earlier picture.
    """

    def __init__(self, model: ObjectModel) -> None:
        self.model, self.state = model, SEARCHING
        self._centres = deque([model.place], QUEUE)
        self._found: list[ObjectPlace] = []  # in the last frames, while it is searched for
        self._unseen: float = math.inf  # frames since it was held, missing ones too
        self._searched = 0  # those in which it was looked for
        self.misfit = False  # whether the last picture had another shape
        self._own: list[float] = []  # when it was held first: ln of its size times its distance

    def look(
        self,
        picture: U8 | None,
        missed: int = 0,
        distance: Callable[[ObjectPlace], float | None] = lambda _: None,
        shared: SharedPictures | None = None,
    ) -> ObjectPlace | None:
        """Where the object is in the next frame; None unless it is held.

        `missed` frames are missing before it; `distance` gives metres to what is at a place;
        `shared` are pictures of the frame that were made already.
        """
        if self.state == LOST:
            return None
        self._unseen += missed
        place = self._place(picture, missed, shared)
        metres = None if place is None else distance(place)
        if place is None or not self._is_same(place, metres):
            self._unseen, self._found = self._unseen + 1, []
            self._searched += self._unseen < math.inf
            self.state = LOST if self._searched > SEARCHED else SEARCHING
            return None
        if self._unseen > QUEUE:
            self._found.append(place)
            if len(self._found) < AGAIN:
                self.state = SEARCHING
                return None
            self._centres, self._found = deque(self._found, QUEUE), []
        self._unseen, self._searched, self.state = 0, 0, HELD
        self._centres.append(place)
        if metres is not None and len(self._own) < QUEUE:
            self._own.append(place.size + math.log(metres))
        return place

    def _place(
        self, picture: U8 | None, missed: int, shared: SharedPictures | None
    ) -> ObjectPlace | None:
        """Where it is in a picture, if that is sure."""
        if picture is None or shape_fault(picture):
            return None
        self.misfit = not self.model.fits(picture)
        if self.misfit:
            return None
        model, detail, least = self.model, detail_picture(picture, shared), MATCH_FINDS
        followed = not self._found and self._unseen <= QUEUE
        if followed:
            place = model.find(detail, *self._course([*self._centres], int(self._unseen)))
            least = max(MATCH_HOLDS, self._centres[-1].match - MATCH_FALLS)
            reach, beside = (place, math.inf, math.inf), 0.0
        else:
            px, size = STEP_PX + WIDENS_PX * self._unseen, STEP_SIZE + WIDENS_SIZE * self._unseen
            reach, beside = (self._centres[-1], px, size), BESIDE
            course = self._course(self._found, missed) if self._found else None
            place = model.find(detail, *course) if course else model.search(detail, *reach)
        if place.match < least or model.texture(detail, place) < TEXTURE:
            return None
        if followed and place.match >= MATCH_FINDS:
            return place
        other = model.search(detail, *reach, but=place)
        return place if other.match < place.match - beside else None

    def _course(self, trail: list[ObjectPlace], unseen: int) -> tuple[ObjectPlace, float, float]:
        """Where the last places lead to after so many unseen frames, and the reach about there."""
        steps = np.diff(np.array([trail[0], *trail]), axis=0)
        about = ObjectPlace(*(trail[-1] + steps.mean(axis=0) * (1 + unseen)).tolist())
        longest = float(np.hypot(steps[:, 0], steps[:, 1]).max())
        px = STEP_PX + WIDENS_PX * unseen + 2 * longest * (1 + unseen)
        return about, px, STEP_SIZE + WIDENS_SIZE * unseen

    def _is_same(self, place: ObjectPlace, metres: float | None) -> bool:
        """Whether its size and its distance are those of the thing that was held first."""
        if metres is None or len(self._own) < QUEUE:
            return True
        return abs(place.size + math.log(metres) - float(median(self._own))) < SAME_THING
