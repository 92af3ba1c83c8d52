"""The video of the live view: an MP4 of what it shows, which can be played after a crash."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import os_errors_as


def new_video(path: Path) -> Path:
    """Make the file that a video is written to until it is whole: ``out.mp4.part``.

    Where a video or the part of one has that name already it is ``out-2.mp4.part``, and so on.
    Raises ToktError if it cannot be made.
    """
    number, whole = 1, path
    with os_errors_as(f"video {path} cannot be written"):
        while True:
            part = whole.with_name(whole.name + ".part")
            with suppress(FileExistsError):
                if not whole.exists():
                    part.open("xb").close()
                    return part
            number += 1
            whole = path.with_stem(f"{path.stem}-{number}")


class ViewVideo:
    """H.264 in fragments, each whole by itself: what a killed process leaves can be read.

    `fault` says why nothing more is written.
    """

    def __init__(self, part: Path) -> None:
        import av

        self._av, self._part, self.fault = av, part, ""
        self._container: Any = None
        self._stream: Any = None
        self._start_s, self._last = 0.0, -1

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        try:
            yield
        except (OSError, self._av.FFmpegError) as error:
            self.fault = str(error)

    def add(self, picture: U8, at_s: float) -> None:
        """Write a picture as of that time; they are as far apart as they were."""
        with self._guarded():
            if self._container is None:
                self._open(*picture.shape[:2])
                self._start_s = at_s
            size = self._stream.width, self._stream.height
            if picture.shape[1::-1] != size:
                picture = np.asarray(cv2.resize(picture, size), np.uint8)
            self._last = max(self._last + 1, round(1000 * (at_s - self._start_s)))
            frame = self._av.VideoFrame.from_ndarray(picture, format="bgr24")
            frame.pts, frame.time_base = self._last, Fraction(1, 1000)
            self._container.mux(self._stream.encode(frame))

    def _open(self, height: int, width: int) -> None:
        flags = {"movflags": "frag_keyframe+empty_moov+default_base_moof", "flush_packets": "1"}
        self._container = self._av.open(str(self._part), "w", format="mp4", options=flags)
        # No frame waits for later ones, and a fragment ends with each tenth.
        fast = {"preset": "veryfast", "tune": "zerolatency", "g": "10"}
        self._stream = self._container.add_stream("libx264", rate=15, options=fast)
        self._stream.width, self._stream.height = width, height
        self._stream.pix_fmt = "yuv420p"
        self._stream.time_base = self._stream.codec_context.time_base = Fraction(1, 1000)

    def close(self) -> None:
        """End the video and give it its name, unless somebody put another there meanwhile."""
        with self._guarded():
            if self._container is None:
                self._part.unlink()
            elif not self.fault:
                self._container.mux(self._stream.encode(None))
                self._container.close()
                with self._part.open("r+b") as written:
                    os.fsync(written.fileno())
                whole = self._part.with_suffix("")
                if not whole.exists():
                    self._part.rename(whole)
