"""The place of the texture detector, whose model can be exchanged between two frames."""

from __future__ import annotations

from dataclasses import replace

from .detector import TEXTURE, Detection, Detector
from .reason import Fault, Reason
from .sources import Frame


class TextureSlot:
    """A detector that passes each frame to the one it holds.

    What it holds is exchanged by the thread that calls `detect`, never within a frame.

    Parameters
    ----------
    detector : Detector or None
    why_none : str
        Why there is no detector, where there is none.
    note : str
        What is not as it should be with the model there is, for every detection's note.
    """

    method = TEXTURE

    def __init__(self, detector: Detector | None, why_none: str = "", note: str = "") -> None:
        self.detector = detector
        self.note = note
        self._why_none = why_none

    def put(self, detector: Detector) -> None:
        """Hold another detector, with which nothing is wrong."""
        self.detector, self.note = detector, ""

    def detect(self, frame: Frame) -> Detection:
        """What the detector says; without one, that there is no model."""
        if self.detector is None:
            words = f"no model: {self._why_none}"
            return Detection(None, TEXTURE, fault=Fault(Reason.NO_MODEL, words))
        found = self.detector.detect(frame)
        if not self.note:
            return found
        return replace(found, note="; ".join(filter(None, (self.note, found.note))))
