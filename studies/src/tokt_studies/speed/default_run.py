"""The case of a whole run: what a frame costs in `tokt run` with its default options and a log."""

import socket
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tokt.inference.verdict import CLEAR
from tokt.models.bundle.bundle import Bundle

from .cases import Picture
from .paired_timing import BASELINE, OURS, Result, in_turns, result
from .pictures_run import DefaultRun

NAME = "run.default"


def measure_default_run(bundle: Bundle, pictures: Sequence[Picture], rounds: int) -> Result:
    """Time the run of some frames in a row, `rounds` times; the times are of one frame."""
    frames = [picture.frame for picture in pictures]
    with (
        tempfile.TemporaryDirectory(prefix="tokt-bench-") as folder,
        socket.socket(type=socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind(("127.0.0.1", 0))
        run = DefaultRun(bundle, receiver.getsockname()[1], Path(folder, "run.jsonl"))
        both = zip(run.texture_alone(frames), run.whole(frames), strict=True)
        exact = not any(ours.status == CLEAR != alone.status for alone, ours in both)
        calls = {BASELINE: run.texture_alone, OURS: run.whole}
        times = in_turns(calls, [frames], rounds)
    a_frame = {way: seconds / len(frames) for way, seconds in times.items()}
    extras = {
        "of": "one decoded frame in a run: checks, texture, flow, publisher, datagram and log",
        "baseline_is": "tokt itself: the texture detector alone",
        "frames": len(frames),
    }
    return result(NAME, a_frame, exact, extras)
