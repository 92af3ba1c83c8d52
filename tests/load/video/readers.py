"""One reader of a stream in a process of its own: OpenCV's, PyAV's, or tokt's without a model.

Arguments: one JSON object, the fields of `Task`. Prints one JSON object, those of `Read`.
"""

import json
import os
import resource
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass

import numpy as np

from tests.inference.sources.video.pictures import number_of
from tests.inference.sources.video.stamps import Stamps
from tokt.features.common.arrays import U8
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig

READERS = ("opencv", "pyav", "tokt")


@dataclass(frozen=True)
class Task:
    reader: str
    url: str
    sdp: str = ""  # a file that says the same to OpenCV and PyAV
    stamps: str = ""
    film: str = ""  # the same pictures with nothing lost: Annex B
    last: int = 0  # the number after which it ends
    seconds: float = 0.0  # or the time
    warm_s: float = 0.0  # of the time, before latency is measured


@dataclass(frozen=True)
class Read:
    latency_ms: list[float]  # from the encoder to the picture in BGR
    cpu_s: float  # of the whole process and of those it started
    pictures: int
    missing: int
    damaged: int  # not, in every pixel, what the same reader makes of the film


def _is_film(where: str) -> bool:
    """A file of pictures: of one that is not buffered, FFmpeg throws the first ones away."""
    return where.endswith((".h264", ".h265"))


def _opencv(where: str) -> Iterator[U8 | None]:
    import cv2

    live = "protocol_whitelist;file,udp,rtp,tcp|fflags;nobuffer|flags;low_delay|rtsp_transport;udp"
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = "" if _is_film(where) else live
    capture = cv2.VideoCapture(where, cv2.CAP_FFMPEG)
    while True:
        done, picture = capture.read()
        if not done:
            return
        yield np.asarray(picture, np.uint8)


def _pyav(where: str) -> Iterator[U8 | None]:
    import av

    options = {"protocol_whitelist": "file,udp,rtp,tcp", "fflags": "nobuffer"}
    options = {} if _is_film(where) else {**options, "flags": "low_delay"}
    with av.open(where, options=options, timeout=20) as container:
        container.streams.video[0].codec_context.thread_count = 1
        with suppress(av.error.ExitError, av.error.TimeoutError):
            for packet in container.demux(video=0):
                with suppress(av.error.InvalidDataError):
                    for frame in packet.decode():
                        yield np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)


def _tokt(where: str) -> Iterator[U8 | None]:
    from tokt.inference.sources.open import open_camera_source

    source = open_camera_source(SourceConfig(source=where), SYSTEM_CLOCK, lambda event: None)
    try:
        for frame in source:
            yield frame.left
    finally:
        source.stop()
        source.close()


_OPEN = {"opencv": _opencv, "pyav": _pyav, "tokt": _tokt}


def read(task: Task) -> Read:
    known = {}
    if task.film:
        frames = _OPEN["pyav" if task.reader == "tokt" else task.reader](task.film)
        known = {number_of(one): zlib.crc32(one.data) for one in frames if one is not None}
    stamps = Stamps(task.stamps) if task.stamps else None
    where = task.url if task.reader == "tokt" else task.sdp or task.url
    latency_ms: list[float] = []
    pictures = missing = damaged = 0
    print("ready", flush=True)
    began = time.monotonic()
    for picture in _OPEN[task.reader](where):
        now = time.monotonic()
        if task.seconds and now > began + task.seconds:
            break
        if picture is None:
            missing += 1
            continue
        pictures += 1
        number = number_of(picture)
        damaged += bool(known) and known.get(number) != zlib.crc32(picture.data)
        at = stamps.of(number) if stamps and number is not None else None
        if at is not None and now > began + task.warm_s:
            latency_ms.append(1e3 * (now - at))
        if task.last and number is not None and number >= task.last:
            break
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu_s = sum(each.ru_utime + each.ru_stime for each in used)
    return Read(latency_ms, cpu_s, pictures, missing, damaged)


if __name__ == "__main__":
    print(json.dumps(asdict(read(Task(**json.loads(sys.argv[1]))))), flush=True)
