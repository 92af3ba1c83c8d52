"""The camera drivers' contract and their captures: the one interface between drivers and source.

A driver knows one camera and nothing of the other. It opens the camera, sets its features and
delivers captures; `live_source.CameraSource` watches it, starts it again when its camera is lost,
and pairs the captures of two.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tokt.features.common.arrays import U8
from tokt.inference.config import SourceConfig
from tokt.inference.reason import NO_FAULT, Fault

GIGABIT_BYTES_S = 115_000_000.0
"""Image data that one gigabit link carries, in bytes a second: Vimba's own default, and that of all
cameras together where no bandwidth is asked for."""

LEFT, RIGHT = 0, 1
SIDES = ("left", "right")
"""How the two are called in words for people."""


@dataclass(frozen=True)
class Capture:
    """One exposure of one camera.

    Its picture is gray (height, width) or in BGR order (height, width, 3), in memory of its own,
    which nobody writes again; None where `fault` says why.
    """

    camera: int  # `LEFT` or `RIGHT`
    frame_id: int  # the camera's own number for it
    taken_s: float  # by the camera's own clock, of any zero; not a number where it did not say
    arrived: float  # when it was complete in this process: `Clock.monotonic`
    t: float  # the same as wall time: seconds since 1970 (UTC)
    picture: U8 | None
    fault: Fault = NO_FAULT
    captured_t: float | None = None  # seconds since 1970 by the camera's clock, where it tells


Deliver = Callable[[Capture], None]
"""Takes a capture; quick, and called from any thread."""


def bandwidth_bytes_s(wanted: SourceConfig) -> float:
    """Bytes a second that all cameras send together.

    Two on one link get half of it each. A camera that cannot send as fast is set to what it can.
    """
    return GIGABIT_BYTES_S if wanted.bandwidth is None else wanted.bandwidth


class CameraDriver(Protocol):
    """One camera, set as `tokt.inference.config.SourceConfig` says.

    With an exposure time or a gain the camera's own control of it is switched off. Without a pixel
    format it keeps its own where that is one of `tokt.features.frames.camera_frame.PIXEL_FORMATS`,
    otherwise takes the first of these that it has. A trigger is what starts each exposure, as the
    camera calls it: two cameras see the same moment only where something starts both. Without PTP
    the difference between their clocks is estimated (`pairing`).

    `start` and `stop` are called from one thread at a time, but not always the same one, and in
    turns for as long as the source lives: a driver is started again after its camera was lost.
    """

    name: str
    """The camera as the user called it, for messages."""
    period_s: float | None
    """Seconds from one exposure to the next as the camera is set; None where it cannot say.

    Asked for after `start`. The source measures it as well, and takes the shorter.
    """
    shared_clock: bool
    """Whether `taken_s` is of a clock that the cameras share (PTP); asked for after `start`."""
    failures: int
    """How often `deliver`, or what came before it, raised: each cost one capture."""

    def start(self, deliver: Deliver) -> None:
        """Open the camera, set its features, and deliver captures until `stop`.

        `deliver` may be called from any thread, but for one driver never from two at once. A
        driver outlives whatever `deliver` raises: it counts it and goes on.

        Raises ToktError if the camera is not there, or cannot be set as asked. Then nothing is left
        open.
        """

    def stop(self) -> None:
        """Deliver nothing more, join the threads of its own and close the camera.

        After it returned `deliver` is not called. May be called twice, and for a camera that was
        pulled out: then it closes what it can. Never raises for a camera that is gone.
        """

    def lost(self) -> str:
        """Why the camera is known to be gone, in words; empty as long as that is not known.

        Asked for some times a second, from the thread that calls `start` and `stop`. It may look
        at the camera, but not for longer than some 10 ms. A driver that cannot tell says "": the
        source sees by itself when nothing is delivered any more.
        """
