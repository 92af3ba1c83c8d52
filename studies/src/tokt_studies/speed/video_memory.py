"""The memory that a run with video in allocates: all of its processes together, at its peak.

Pages of programs and libraries come on top: 12 to 37 MB (10**6 bytes) are used after the first
verdict. They are not counted, as the system keeps more or fewer pages around the used ones (50 to
85 MB of the same run, by the version of Linux), and drops them where memory is short. Processes are
looked at every `_LOOK_S`, so that a peak of some milliseconds may be missed. Linux only.
"""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import cycle, islice
from pathlib import Path

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle

CORES = 4
"""Of a small computer. FFmpeg decodes a file of H.264 on all there are, with a picture on each."""
ENCODERS = {
    "h264": ("libx264", "-preset", "ultrafast", "-refs", "2", "-pix_fmt", "yuv420p"),
    "mjpeg": ("mjpeg", "-q:v", "3", "-pix_fmt", "yuvj420p"),
}
"""FFmpeg's and their settings, by the form of video."""
NETWORK = "h264.network"
"""Video over UDP, which a process of its own decodes."""
FRAMES = 64

_NOISE = 2  # grey levels: no picture comes again
_RATE = 10  # frames a second
_OPEN_S = 4.0  # until video from the network is judged
_LOOK_S = 0.02
_FFMPEG = ("ffmpeg", "-hide_banner", "-loglevel", "error", "-nostdin", "-y")
_ALLOCATED = re.compile(r"^Anonymous:\s+(\d+) kB", re.MULTILINE)  # proc(5)
_KB = 1024 / 1e6  # in MB (10**6 bytes)


def can_be_measured() -> bool:
    """Return whether this system tells the memory of processes, and has FFmpeg's program."""
    return Path("/proc/self/smaps_rollup").exists() and shutil.which("ffmpeg") is not None


def write_video(pictures: Sequence[U8], file: Path, form: str, frames: int) -> None:
    """Write BGR pictures as a video, again and again, each time with other noise on top.

    `form` is one of `ENCODERS`. Raises ToktError if FFmpeg cannot write it.
    """
    high, wide = (side // 2 * 2 for side in pictures[0].shape[:2])  # as H.264 has them
    raw = ("-f", "rawvideo", "-pix_fmt", "bgr24", "-s", f"{wide}x{high}", "-r", str(_RATE))
    encoder = ("-c:v", *ENCODERS[form], "-g", str(_RATE), "-bf", "0", "-threads", "1")
    command = [*_FFMPEG, *raw, "-i", "pipe:0", *encoder, str(file)]
    random = np.random.default_rng(0)
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process, suppress(BrokenPipeError):
        assert process.stdin is not None
        for picture in islice(cycle(pictures), frames):
            shown = picture[:high, :wide]
            noisy = shown + random.integers(-_NOISE, _NOISE + 1, shown.shape, np.int16)
            process.stdin.write(noisy.clip(0, 255).astype(np.uint8).tobytes())
    if process.returncode:
        raise ToktError(f"ffmpeg cannot write {file}")


def measure_video_memory(
    bundle: Bundle, pictures: Sequence[U8], folder: Path, frames: int = FRAMES
) -> dict[str, float]:
    """Run a model on videos of some pictures, with a receiver and a log and options as they are.

    Returns
    -------
    dict
        Peak of what is allocated in MB (10**6 bytes), by the form of video: files of each of
        `ENCODERS`, and `NETWORK`.
    """
    folder.mkdir(parents=True)
    model = folder / "m.tokt"
    model.write_bytes(bundle.data)
    found = {}
    for form in ENCODERS:
        file = folder / f"{form}.mkv"
        write_video(pictures, file, form, frames)
        found[form] = _peak_mb(model, str(file))
    with _sent(folder / "h264.mkv") as address:
        found[NETWORK] = _peak_mb(model, address, _OPEN_S + frames / _RATE)
    return found


@contextmanager
def _sent(file: Path) -> Iterator[str]:
    """Send a video over UDP, again and again as if live; gives its address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"udp://127.0.0.1:{free.getsockname()[1]}"
    to = ["-c", "copy", "-f", "mpegts", f"{address}?pkt_size=1316"]
    with subprocess.Popen([*_FFMPEG, "-re", "-stream_loop", "-1", "-i", str(file), *to]) as sender:
        try:
            yield address
        finally:
            sender.kill()


def _peak_mb(model: Path, source: str, seconds: float | None = None) -> float:
    """The peak of a run that ends with its source, or after some seconds; ToktError if it fails."""
    log, said = model.with_suffix(".jsonl"), model.with_suffix(".txt")
    command = [sys.executable, "-m", "tokt", "run", "--bundle", str(model), "--source", source]
    command += ["--udp", "127.0.0.1:9", "--log", str(log)]
    some_cores = None
    if sys.platform == "linux":  # elsewhere nothing is measured
        some_cores = partial(os.sched_setaffinity, 0, sorted(os.sched_getaffinity(0))[:CORES])
    peak, end = 0.0, time.monotonic() + (seconds or float("inf"))
    with said.open("wb") as errors:
        run = subprocess.Popen(command, stderr=errors, cwd=model.parent, preexec_fn=some_cores)
        while run.poll() is None:
            peak = max(peak, _allocated_mb(run.pid))
            if time.monotonic() > end:
                run.terminate()
            time.sleep(_LOOK_S)
    if run.returncode or not log.stat().st_size:
        words = said.read_text("utf-8", "replace").split()
        raise ToktError(f"a run on {source} ended with {run.returncode}: {' '.join(words)[-300:]}")
    log.unlink()
    return peak


def _allocated_mb(process: int) -> float:
    """What a process and those that it started have allocated."""
    allocated = 0
    for number in _with_started(process):
        with suppress(OSError):  # it has ended
            told = Path(f"/proc/{number}/smaps_rollup").read_text("ascii")
            allocated += sum(map(int, _ALLOCATED.findall(told)))
    return allocated * _KB


def _with_started(process: int) -> Iterator[int]:
    yield process
    with suppress(OSError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            for number in (thread / "children").read_text("ascii").split():
                yield from _with_started(int(number))
