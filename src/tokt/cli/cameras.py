"""`tokt cameras`: the cameras that there are, and what one of them sends."""

import json as json_text
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from statistics import median
from threading import Timer
from typing import Annotated, Any

from typer import Argument, Option

from tokt.features.common.address import without_credentials
from tokt.features.common.errors import ToktError
from tokt.features.common.terminal import say, stop_on_signal

from .options import JsonOption
from .output import answer
from .output import print_line as print

_DEVICES = Path("/dev")
_NETWORK = (
    "rtsp://HOST:PORT/PATH  IP cameras, BlueOS",
    "rtp://:5600            RTP sent to this computer: BlueOS's default",
    "udp://:PORT            MPEG-TS sent to this computer",
    "http://HOST/PATH       MJPEG",
)


def cameras(
    source: Annotated[
        str | None, Argument(help="Camera or stream to try, as for tokt run --source.")
    ] = None,
    seconds: Annotated[float, Option(help="Time for which it is tried.", min=0.5, max=3600)] = 5.0,
    json: JsonOption = False,
) -> None:
    """List cameras, or try one and print its [source] section."""
    if source is None:
        found = _found()
        answer(json, found, lambda: _print_found(found))
        return
    tried = _tried(source, seconds)
    answer(json, tried, lambda: _print_tried(tried))


def _found() -> dict[str, Any]:
    """Every camera of this computer, and what keeps others from being found."""
    from tokt.inference.sources.cameras.genicam.producers import list_cameras
    from tokt.inference.sources.cameras.vimba.system import camera_driver_finding
    from tokt.inference.sources.cameras.vimba.vimbax_system import vimbax_finding

    found = list(_usb())
    notes: list[str] = []
    try:
        listing = list_cameras()
        found += [(f"genicam:{each.place.device}", each.in_words()) for each in listing.cameras]
        notes += listing.complaints
    except ToktError as error:
        notes.append(str(error))
    notes += [finding.text for finding in (camera_driver_finding(), vimbax_finding())]
    named = [{"source": source, "name": name} for source, name in found]
    return {"cameras": named, "notes": notes}


def _usb() -> Iterator[tuple[str, str]]:
    """USB cameras, named by what stays when they are plugged in elsewhere."""
    if sys.platform != "linux":
        return
    from tokt.inference.sources.video.modes import describe_camera

    links = {link.resolve(): link for link in sorted((_DEVICES / "v4l" / "by-id").glob("*"))}
    for device in sorted(_DEVICES.glob("video*")):
        try:
            name, formats = describe_camera(str(device))
        except OSError as error:
            yield f"v4l2:{device}", str(error.strerror)
            continue
        if formats:
            yield f"v4l2:{links.get(device, device)}", f"{name}, {device}: {', '.join(formats)}"


def _print_found(found: dict[str, Any]) -> None:
    for camera in found["cameras"]:
        print(f"{camera['source']}  ({camera['name']})")
    if not found["cameras"]:
        print("no camera at this computer")
    for note in found["notes"]:
        print(f"note: {note}")
    print()
    print("Video of the network is named by its address:")
    for line in _NETWORK:
        print(f"  {line}")
    print("Try one: tokt cameras SOURCE")


def _tried(source: str, seconds: float) -> dict[str, Any]:
    """What a source sends, seen as a run sees it; ToktError if that is nothing."""
    from tokt.inference.clock import SYSTEM_CLOCK
    from tokt.inference.config import SourceConfig
    from tokt.inference.frame import MANY_MISSED
    from tokt.inference.sources.open import is_camera_source, open_camera_source

    if not is_camera_source(source):
        raise ToktError(f"{source!r} names no camera or stream (tokt cameras lists them)")
    at, ages, faults = [], [], Counter[str]()
    sizes, last, missed = "", "nothing came", 0
    opened = open_camera_source(SourceConfig(source), SYSTEM_CLOCK, lambda event: say(event.words))
    timer = Timer(seconds, opened.stop)
    timer.daemon = True
    with closing(opened), stop_on_signal(opened.stop):
        timer.start()
        for frame in opened:
            missed += frame.missed if frame.missed < MANY_MISSED else 0
            if frame.left is None:
                last = str(frame.left_fault)
                faults[frame.left_fault.reason] += 1
                continue
            at.append(SYSTEM_CLOCK.monotonic())
            ages.append(at[-1] - (frame.arrived or at[-1]))
            views = (view.shape for view in (frame.left, frame.right) if view is not None)
            sizes = " and ".join(f"{s[1]}x{s[0]}{' gray' if len(s) == 2 else ''}" for s in views)
        timer.cancel()
    shown = without_credentials(source)
    if not at:
        raise ToktError(f"source {shown}: no picture ({last})")
    return {
        "source": shown,
        "has_credentials": shown != source,
        "size": sizes,
        "rate": round((len(at) - 1) / (at[-1] - at[0]), 2) if len(at) > 1 else None,
        "pictures": len(at),
        "without_picture": dict(faults),
        "last_fault": last if faults else "",
        "missed": missed,
        "age_s": {"median": round(median(ages), 4), "max": round(max(ages), 4)},
    }


def _print_tried(tried: dict[str, Any]) -> None:
    """The section of a configuration file, the figures as comments above it."""
    rate = "" if tried["rate"] is None else f", {tried['rate']:g} pictures a second"
    median_ms, max_ms = (1e3 * seconds for seconds in tried["age_s"].values())
    print(f"# {tried['size']}{rate}")
    print(f"# age where it is judged: median {median_ms:.0f} ms, at most {max_ms:.0f} ms")
    print(f"# {tried['pictures']} pictures; {tried['missed']} missed")
    for reason, count in tried["without_picture"].items():
        print(f"# {count} without a picture: {reason}")
    if tried["last_fault"]:
        print(f"# the last of them: {tried['last_fault']}")
    if tried["has_credentials"]:
        print("# user and password: the environment's TOKT_SOURCE_USER and TOKT_SOURCE_PASSWORD")
    print("[source]")
    print(f"source = {json_text.dumps(tried['source'], ensure_ascii=False)}")
