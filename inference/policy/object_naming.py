"""Naming the object to hold: a box in a frame, on the command line or on the live view's page."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError, naming
from tokt.features.frames.image_file import read_image
from tokt.features.frames.mission import LEFT, Mission
from tokt.inference.frame import pixel_mark
from tokt.inference.report import Event
from tokt.inference.sources.files import read_picture

from .object_model import Box, ObjectModel
from .object_tracker import ObjectTracker
from .temporal_cues import TemporalCues

NAMED, REFUSED = "object_named", "object_refused"
"""Events: a person named an object, or that there is none any more; it cannot be held."""
_TEXT = re.compile(r"(.+):(\d{1,5}),(\d{1,5}),(\d{1,5}),(\d{1,5})")


@dataclass(frozen=True)
class NamedBox:
    """``FRAME:X,Y,W,H``: a picture (its file, or its number in the source) and a box in pixels."""

    frame: str
    box: Box

    @classmethod
    def parse(cls, text: str) -> NamedBox:
        """Read what a user wrote; ToktError if it is something else."""
        match = _TEXT.fullmatch(text.strip())
        if match is None:
            raise ToktError(
                f"--anchor-from is FRAME:X,Y,W,H: an image file or a frame's number, and a box in "
                f"its pixels, not {text!r}"
            )
        x, y, wide, high = map(int, match.groups()[1:])
        return cls(match[1], (x, y, wide, high))

    @property
    def number(self) -> int | None:
        """The frame's number in the source, unless it is a file."""
        return int(self.frame) if self.frame.isascii() and self.frame.isdigit() else None

    def picture(self, mission: Mission | None, pixel_format: str | None) -> U8:
        """The picture, of the mission where it is a number; ToktError if it is not there."""
        if self.number is None:
            return read_image(Path(self.frame))
        if mission is None:
            raise ToktError("--anchor-from: only recorded frames have numbers; name an image file")
        picture, fault = read_picture(mission, self.number, LEFT, pixel_format)
        if picture is None:
            raise ToktError(f"--anchor-from: {fault}")
        return picture


class NamedObject(NamedTuple):
    """An object that was named before the run."""

    tracker: ObjectTracker
    text: str  # the box and its picture: a file by its whole path
    mark: str  # of the picture


def named_object(text: str, mission: Mission | None, pixel_format: str | None) -> NamedObject:
    """The object that a user named; ToktError if it is not there, or cannot be held."""
    named = NamedBox.parse(text)
    picture = named.picture(mission, pixel_format)
    with naming("--anchor-from"):
        tracker = ObjectTracker(ObjectModel(picture, named.box), anywhere=True)
    frame = named.frame if named.number is not None else str(Path(named.frame).absolute())
    box = ",".join(map(str, named.box))
    return NamedObject(tracker, f"{frame}:{box}", pixel_mark(picture))


class ObjectNaming:
    """What a person names while the run goes on: learnt by another thread, held by the loop's."""

    def __init__(self, cues: TemporalCues, time_s: Callable[[], float]) -> None:
        self._cues, self._time_s = cues, time_s
        self._waiting: deque[tuple[Event, ObjectModel | None]] = deque()

    def name(self, number: int, picture: U8 | None, box: Box) -> None:
        """Learn what is in a box of a frame; from any thread."""
        mark = None if picture is None else pixel_mark(picture)
        told = {"frame": number, "box": [*box], "mark": mark}
        try:
            if picture is None:
                raise ToktError(f"frame {number} is not kept any more: draw again")
            model = ObjectModel(picture, box)
        except ToktError as error:
            self._waiting.append((Event(self._time_s(), REFUSED, str(error), told), None))
            return
        words = f"an object was named in frame {number}"
        self._waiting.append((Event(self._time_s(), NAMED, words, told), model))

    def release(self) -> None:
        """Hold nothing any more; from any thread."""
        told = {"frame": None, "box": None, "mark": None}
        words = "no object is held any more"
        self._waiting.append((Event(self._time_s(), NAMED, words, told), None))

    def take(self) -> list[Event]:
        """Do what was asked for, between two frames, and what there is to tell of it."""
        events = []
        for _ in range(len(self._waiting)):
            event, model = self._waiting.popleft()
            if event.name == NAMED:
                self._cues.hold(model, event.fields["frame"])
            events.append(event)
        return events
