"""Reasons: the codes that say why a verdict is unknown or doubtful, and the words with them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class Reason(StrEnum):
    """Codes of what was not as it should be, as datagrams, logs and counters carry them.

    Each has its `meaning`, and the `advice` what to do: docs/reference/reasons.md is made of them.
    """

    meaning: str
    advice: str

    def __new__(cls, code: str, meaning: str = "", advice: str = "") -> Reason:
        """Return a member that compares and is written as its code.

        Type checkers take ``Reason("ok")``, which looks a member up, for a call of this.
        """
        made = str.__new__(cls, code)
        made._value_, made.meaning, made.advice = code, meaning, advice
        return made

    OK = ("ok", "Nothing is wrong.", "There is nothing to do.")

    # No frame, or one that is too old.
    NO_FRAME = (
        "no_frame",
        "No frame has come since the start.",
        "Check that the camera or the stream sends.",
    )
    STALE = (
        "stale",
        "No frame has come for too long, or a frame is too old, as after a suspend.",
        "Check the camera, the cable and the network.",
    )
    LATE = (
        "late",
        "Judging took so long that a clear is of a frame that is gone.",
        "Free the processor, raise `--threads`, or lower `--stereo-scale`.",
    )
    STALLED = (
        "stalled",
        "A frame is being judged for too long.",
        "Free the processor; run with `--watchdog`, which restarts what hangs.",
    )
    OVERLOAD = (
        "overload",
        "Frames come faster than they are judged: some before this were left out.",
        "Lower the camera's rate, or raise `--threads`.",
    )

    # A frame without a picture.
    MISSING = (
        "missing",
        "A camera gave no picture, or its file is not there.",
        "Check the camera, or the mission's folder.",
    )
    UNREADABLE = (
        "unreadable",
        "A picture cannot be decoded.",
        "Look at the file; health says what is wrong with it.",
    )
    INCOMPLETE = (
        "incomplete",
        "A camera gave only a part of a picture.",
        "Check the cable and the network; set `--packet-size` or `--bandwidth`.",
    )
    UNPAIRED = (
        "unpaired",
        "The other camera has no picture of the same moment.",
        "Check both cameras, their trigger and their clocks (`--trigger`, `--ptp`).",
    )
    CAMERA_LOST = (
        "camera_lost",
        "A camera does not answer.",
        "Check its power and its cable; tokt opens it again by itself.",
    )

    # A picture that cannot be judged.
    DARK = (
        "dark",
        "A picture is too dark.",
        "Raise the lamps or the exposure; look whether something covers the lens.",
    )
    SATURATED = (
        "saturated",
        "A picture is overexposed.",
        "Lower the lamps, the exposure or the gain.",
    )
    BLANK = (
        "blank",
        "A picture shows nothing, or noise alone.",
        "Look at the picture, and whether something covers the lens.",
    )
    DAMAGED = (
        "damaged",
        "A part of a picture has rows that repeat, or noise that no camera gives: damaged or "
        "covered.",
        "Check the network for losses, and whether something covers the lens. For a camera or a "
        "size of frames that the model did not learn, name sharp frames of it (`--sharp-frames`).",
    )
    BLURRED = (
        "blurred",
        "A part of the view has none of the fine detail that the camera's pictures have.",
        "Clean the port; check the focus, and whether the video is compressed more than in "
        "training. For a camera that the model did not learn, name sharp frames of it "
        "(`--sharp-frames`).",
    )
    VISIBILITY = (
        "visibility",
        "The water lets too little contrast through: what is there may not be seen.",
        "Go slower and nearer, lower the lamps; label frames of this water and run `tokt adapt`.",
    )
    FROZEN = (
        "frozen",
        "A camera repeats its last picture, a part of it, or an earlier one.",
        "Restart the camera or its encoder.",
    )
    WRONG_SIZE = (
        "wrong_size",
        "A picture has not the size the model learnt from, or the calibration is for.",
        "Set the camera as it was in training, or train and calibrate for it as it is.",
    )
    NO_COLOUR = (
        "no_colour",
        "A picture is gray, and the model looks at colours.",
        "Set a pixel format with colour, or deploy a model that needs none.",
    )

    # A detector that cannot judge.
    DETECTOR_FAILED = (
        "detector_failed",
        "A detector failed.",
        "Report it with the words of health.",
    )
    NOT_FINITE = (
        "not_finite",
        "The model gave a number that is none.",
        "Roll back to the model before it (`tokt rollback`), and report it.",
    )
    FRAME_RULE = (
        "frame_rule",
        "The frame rule needs frames before this one that are not known.",
        "Wait for frames that can be judged; the reasons of those before say what is wrong.",
    )
    STEREO = (
        "stereo",
        "The two views of a pair do not fit together, or show too little.",
        "Look at both pictures; measure the calibration again (`tokt calibrate`).",
    )
    DRIFT = (
        "drift",
        "Nothing is seen in a picture that is unlike those the model learnt from.",
        "Check the lens and the light; label frames of this water and run `tokt adapt`.",
    )
    NOVEL = (
        "novel",
        "Nothing is seen in a picture with a patch unlike all that the model learnt.",
        "Look at the picture; label such patches and run `tokt adapt`.",
    )
    SEDIMENT = (
        "sediment",
        "Nothing is seen, and a cloud of sediment hides a wide part of the view.",
        "Wait until it has settled or drifted off, or go up.",
    )
    MOVING = (
        "moving",
        "Nothing is seen but things that move by themselves, such as fish.",
        "Wait until they have passed; `--moving all` makes them an obstacle.",
    )
    NO_MODEL = ("no_model", "There is no model.", "Deploy a model to the store (`tokt deploy`).")


_MOST_ADVISED = 2


def unknown_in_words(counts: Mapping[str, int]) -> list[str]:
    """Return lines that say why frames are unknown, and what to do about the commonest reasons.

    `counts` are frames by the code of their reason; of none there is no line.
    """
    if not counts:
        return []
    ranked = sorted(counts, key=lambda code: (-counts[code], code))
    lines = [f"unknown: {', '.join(f'{counts[code]} {code}' for code in ranked)}"]
    for code in ranked[:_MOST_ADVISED]:
        reason = Reason(code)
        lines.append(f"  {code}: {reason.meaning} {reason.advice}")
    return lines


class Fault(str):
    """Why something could not be judged, in words; empty where nothing is wrong."""

    __slots__ = ("reason",)
    reason: Reason

    def __new__(cls, reason: Reason, words: str) -> Fault:
        """Words with a code."""
        made = super().__new__(cls, words)
        made.reason = reason
        return made

    def __getnewargs__(self) -> tuple[Reason, str]:  # type: ignore[override]
        """What pickle and copy make it anew from."""
        return self.reason, str(self)

    def about(self, what: str) -> Fault:
        """The same of one part of a frame, such as ``"left"``."""
        return Fault(self.reason, f"{what}: {self}")


NO_FAULT = Fault(Reason.OK, "")
