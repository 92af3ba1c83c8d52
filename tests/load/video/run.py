"""The measurements of network video, one after the other."""

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.inference.sources.video.senders import Film, gst_rtp, rtsp
from tests.load.report import Found, machine_words, percentiles, table
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.common.terminal import say

from .captures import Counted, count_captures, judged_share
from .latency import bare_codec, lossy_read, reader_latency, run_latency
from .live import count_live
from .readers import READERS

ALL = ("captures", "live", "share", "latency", "readers")


@dataclass(frozen=True)
class VideoSize:
    captures: int = 10_000
    streams: int = 200  # live ones, half of each codec
    shares: int = 20  # captures at each bit rate
    seconds: float = 60.0  # of each latency
    pictures: int = 900  # that each reader is sent where some packets are lost
    film: Film = Film(size=(1920, 1080), kbit=8000)  # noqa: RUF009 - frozen
    lossy: Film = Film(size=(640, 480), kbit=2000)  # noqa: RUF009 - frozen
    bitrates: tuple[int, ...] = (500_000, 1_000_000, 2_000_000, 4_000_000)
    losses: tuple[float, ...] = (0.001, 0.01)


MAX_BACK_S = 2.0
_COUNTED = ("sent", "whole", "missing", "damaged")
FULL = VideoSize()
QUICK = VideoSize(
    *(60, 4, 1, 3.0, 210, Film(size=(640, 480), kbit=3000), Film(size=(320, 240), kbit=800)),
    *((1_000_000,), (0.01,)),
)


def run_video_bench(extent: VideoSize, parts: tuple[str, ...] = ALL) -> Found:
    if sys.platform != "linux":
        raise ToktError("the cameras of this measurement are Linux programs")
    if unknown := set(parts) - set(ALL):
        raise ToktError(f"no part {min(unknown)!r}: {', '.join(ALL)}")
    figures: dict[str, Any] = {"extent": asdict(extent), "machine": machine()}
    report: list[Any] = []
    with tempfile.TemporaryDirectory(prefix="tokt-video-") as name:
        folder = Path(name)
        for part in parts:
            say(f"-- {part}")
            found, rows = _PARTS[part](extent, folder)
            figures[part] = found
            report += rows
    report.append(machine_words(figures))
    fault = "; ".join(_faults(figures, whole=extent == FULL))
    return Found("video", figures, report, fault=fault)


def _faults(figures: dict[str, Any], whole: bool) -> Iterator[str]:
    """What may not be; of times only where all is measured."""
    counted = [figures[part] for part in ("captures", "live") if part in figures]
    ours = [found for name, found in figures.get("readers", ()) if name.startswith("tokt")]
    if damaged := sum(found["damaged"] for found in (*counted, *ours)):
        yield f"{damaged} damaged pictures were given as whole"
    if whole and any(found["first_s"].get("max", 0) > MAX_BACK_S for found in counted):
        yield f"the first picture came more than {MAX_BACK_S:g} s after a key picture"
    bare, *ways = figures.get("latency", [{}])
    for way in ways if whole else ():
        over = [way[name] - bare[name] for name in ("median_ms", "p99_ms")]
        if way["way"].endswith("datagram") and (over[0] > 60 or over[1] > 120):
            yield f"{way['way']} takes {over[0]:.0f} (99 %: {over[1]:.0f}) ms more than the codec"


def _captures(extent: VideoSize, folder: Path) -> tuple[Any, list[Any]]:
    return _counts("captures", count_captures(extent.captures))


def _live(extent: VideoSize, folder: Path) -> tuple[Any, list[Any]]:
    one, two = (count_live(extent.streams // 2, codec) for codec in ("h264", "h265"))
    for name in ("streams", *_COUNTED, "first_s"):
        setattr(one, name, getattr(one, name) + getattr(two, name))
    return _counts("live streams", one)


def _counts(what: str, counted: Counted) -> tuple[Any, list[Any]]:
    first: dict[str, float] = {}
    if times_s := counted.first_s:
        first = percentiles(times_s, median=50, p90=90, p99=99, max=100)
    found = {**asdict(counted), "first_s": first}
    headings = (what, "pictures sent", "whole", "missing", "damaged as whole", "first picture (s)")
    words = ", ".join(f"{name} {value:.2f}" for name, value in first.items())
    row = [*(str(found[name]) for name in ("streams", *_COUNTED)), words]
    return found, [table(headings, [row], "first picture (s)")]


def _share(extent: VideoSize, folder: Path) -> tuple[Any, list[Any]]:
    rows = [
        (codec, loss, judged_share(bitrate, loss, extent.shares, (640, 480), 300, codec))
        for codec in ("h264", "h265")
        for loss in extent.losses
        for bitrate in extent.bitrates
    ]
    headings = ("codec", "loss", "Mbit/s", "packets a picture", "judged", "whole themselves")
    texts = [
        (
            *(codec, f"{loss:.1%}", f"{share.bitrate / 1e6:g}", f"{share.packets_a_picture:.1f}"),
            *(f"{share.whole:.1%}", f"{share.intact:.1%}"),
        )
        for codec, loss, share in rows
    ]
    return [{"codec": c, "loss": p, **asdict(s)} for c, p, s in rows], [table(headings, texts)]


def _latency(extent: VideoSize, folder: Path) -> tuple[Any, list[Any]]:
    film, found = extent.film, [bare_codec(extent.film, int(extent.seconds * extent.film.rate))]
    with rtsp(folder, film) as camera:
        found.append(run_latency(folder, camera, camera.url, "RTSP to datagram", extent.seconds))
        for reader in READERS:
            found.append(reader_latency(folder, camera, reader, extent.seconds))
    with gst_rtp(folder, film) as camera:
        found.append(run_latency(folder, camera, camera.url, "RTP to datagram", extent.seconds))
    bare = found[0].median_ms
    headings = ("way", "median ms", "p99 ms", "over the codec's", "CPU", "pictures")
    texts = [
        [
            *(each.way, f"{each.median_ms:.1f}", f"{each.p99_ms:.1f}"),
            *(f"{each.median_ms - bare:+.1f}", f"{each.cpu_share or 0:.0%}", str(each.count)),
        ]
        for each in found
    ]
    return [asdict(each) for each in found], [table(headings, texts)]


def _readers(extent: VideoSize, folder: Path) -> tuple[Any, list[Any]]:
    found = {
        f"{reader}, {loss:.1%} lost": asdict(
            lossy_read(folder, reader, loss, extent.lossy, extent.pictures)
        )
        for loss in (0.0, *extent.losses)
        for reader in READERS
    }
    headings = ("reader", "pictures", "of them damaged", "said to be missing", "CPU s")
    texts = [
        (name, *(f"{one[key]:.4g}" for key in ("pictures", "damaged", "missing", "cpu_s")))
        for name, one in found.items()
    ]
    return list(found.items()), [table(headings, texts)]


_PARTS = dict(zip(ALL, (_captures, _live, _share, _latency, _readers), strict=True))
