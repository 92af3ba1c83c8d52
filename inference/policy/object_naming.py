"""Naming the object to hold: a box in a frame, on the command line or on the live view's page."""

import re
from collections import deque
from collections.abc import Callable
from pathlib import Path

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import read_image
from tokt.features.frames.mission import LEFT, Mission
from tokt.inference.frame import pixel_mark
from tokt.inference.report import Event
from tokt.inference.sources.files import read_picture

from .object_model import Box, ObjectModel, detail_picture
from .object_tracker import ObjectTracker
from .temporal_cues import TemporalCues

NAMED, REFUSED = "object_named", "object_refused"  # events: it is to be held, or cannot be
MAX_SIZE_ERROR = 0.35
"""Of ln of the wanted size over that in the box: half or twice its share."""
_TEXT = re.compile(r"(.+):(\d{1,5}),(\d{1,5}),(\d{1,5}),(\d{1,5})")


def parse_named(text: str) -> tuple[int | str, Box]:
    """The picture and the box, in its pixels, of ``FRAME:X,Y,W,H``; ToktError if it is not that."""
    match = _TEXT.fullmatch(text.strip())
    if match is None:
        raise ToktError(
            f"--anchor-from is FRAME:X,Y,W,H: an image file or a frame's number, and a box in "
            f"its pixels, not {text!r}"
        )
    frame = match[1]
    number = frame.isascii() and frame.isdigit()
    x, y, wide, high = map(int, match.groups()[1:])
    return int(frame) if number else str(Path(frame).absolute()), (x, y, wide, high)


def named_picture(frame: int | str, mission: Mission | None, pixel_format: str | None) -> U8:
    """The picture, of the mission where it is a number; ToktError if it is not there."""
    if isinstance(frame, str):
        return read_image(Path(frame))
    if mission is None:
        raise ToktError("--anchor-from: only recorded frames have numbers; name an image file")
    picture, fault = read_picture(mission, frame, LEFT, pixel_format)
    if picture is None:
        raise ToktError(f"--anchor-from: {fault}")
    return picture


class ObjectNaming:
    """What a person names: learnt by any thread, held by the loop's from the next frame on."""

    def __init__(self, cues: TemporalCues | None, time_s: Callable[[], float]) -> None:
        self.cues = cues  # of the policy; None until there is one
        self._time_s = time_s
        self._waiting: deque[tuple[ObjectModel, Event]] = deque()
        self._misfit: ObjectTracker | None = None  # the last that frames did not fit, as was told

    def name(self, frame: int | str, detail: U8, box: Box) -> None:
        """Learn what is in a box, in shares of a frame's sides; ToktError if it cannot be held."""
        told = {"frame": frame, "box": [*box], "mark": pixel_mark(detail)}
        event = Event(self._time_s(), NAMED, f"an object was named in frame {frame}", told)
        model, anchor = ObjectModel(detail, box), None if self.cues is None else self.cues.anchor
        if anchor is not None and abs(model.size_of(anchor.size)) > MAX_SIZE_ERROR:
            held = " to ".join(f"{model.share * part:.2g}" for part in (0.5, 2))
            raise ToktError(f"--anchor {anchor.size:g}: in this box the object is held at {held}")
        self._waiting.append((model, event))

    def name_before(self, text: str, mission: Mission | None, pixel_format: str | None) -> None:
        """The same of ``FRAME:X,Y,W,H``."""
        frame, (x, y, wide, high) = parse_named(text)
        picture = named_picture(frame, mission, pixel_format)
        rows, cols = picture.shape[:2]
        self.name(frame, detail_picture(picture), (x / cols, y / rows, wide / cols, high / rows))

    def take(self) -> list[Event]:
        """Hold what was named, between two frames; what there is to tell of it."""
        events: list[Event] = []
        if self.cues is None:
            return events
        while self._waiting:
            model, event = self._waiting.popleft()
            self.cues.tracker = ObjectTracker(model)
            events.append(event)
        tracker = self.cues.tracker
        if tracker is not None and tracker.misfit and tracker is not self._misfit:
            self._misfit = tracker
            words = "frames have another shape than the picture in which the object was named"
            events.append(Event(self._time_s(), REFUSED, words))
        return events
