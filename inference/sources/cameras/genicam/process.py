"""The process of one GenICam camera, or of the list of all: ``python -m`` this module.

A process of its own, for three reasons. The genicam binding keeps Python's lock while it waits for
a frame, looks for cameras or opens one (a wait of 100 ms stops every thread for 100 ms). Producers
are the vendors' native code: one that crashes or hangs is a camera lost, and not the runtime. And a
producer that lost its camera may keep its memory; here that goes with the process.

What it is told and what it answers: `cameras.messages`.
"""

import signal
import threading
from dataclasses import asdict
from typing import IO, Any

from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.sources.cameras.messages import (
    begun,
    end_unless_called_again,
    write_frame,
    write_message,
)

from .camera import GenicamCamera, opened_camera
from .producers import ListedCamera, Listing, Place, in_one_line, opened_producers

_SLOW_S = 0.02
_OPEN_S = 60.0
_HUNG_S = 10.0  # a call that takes longer hangs; the runtime has given up long before


def main() -> None:
    """Do what the first line of the standard input says until that is closed."""
    end_unless_called_again(_OPEN_S)
    answers, order, stopped = begun()
    try:
        if "list" in order:
            with opened_producers() as producers:
                write_message(answers, {"kind": "listed", "listing": asdict(producers.listing)})
        else:
            _run(answers, order, stopped)
    except BrokenPipeError:
        return  # the runtime is gone, or does not listen any more
    except ToktError as error:
        write_message(answers, {"kind": "refused", "words": str(error)})
    except Exception as error:  # noqa: BLE001 - foreign code; nobody would see the traceback
        words = in_one_line(f"{type(error).__name__}: {error}")
        write_message(answers, {"kind": "refused", "words": words})


def _run(answers: IO[bytes], order: dict[str, Any], stopped: threading.Event) -> None:
    """Send a camera's frames."""
    options = SourceConfig(**order["options"])
    with opened_producers() as producers:
        listed = _chosen(producers.listing, order)
        with opened_camera(producers, listed, order["name"], options, order["share"]) as camera:
            # harvesters takes the signal for itself.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            ready = {"period_s": camera.period_s, "shared_clock": camera.shared_clock}
            write_message(answers, {"kind": "ready", "place": vars(listed.place), **ready})
            try:
                while not stopped.is_set():
                    end_unless_called_again(_HUNG_S)
                    _send_next(answers, camera)
            except camera.gone as error:
                # Told before it is closed, which may hang or fail as well.
                write_message(answers, {"kind": "lost", "words": in_one_line(str(error))})


def _chosen(listing: Listing, order: dict[str, Any]) -> ListedCamera:
    """The camera that the order names, by its place if that is known."""
    if order["place"] is None:
        return listing.camera(order["name"])
    place = Place(**order["place"])
    for camera in listing.cameras:
        if camera.place == place:
            return camera
    raise ToktError(f"no GenICam camera {order['name']!r}: {listing.in_words()}")


def _send_next(answers: IO[bytes], camera: GenicamCamera) -> None:
    with camera.next() as taken:
        if taken is None:
            return
        started = SYSTEM_CLOCK.monotonic()
        write_frame(answers, *taken)
    # The runtime did not read: what was filled meanwhile is older than it looks.
    if SYSTEM_CLOCK.monotonic() - started > _SLOW_S:
        camera.forget_waiting()


if __name__ == "__main__":
    main()
