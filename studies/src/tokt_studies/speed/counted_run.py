"""The process whose instructions are counted: a run of pictures, cut where a stage begins or ends.

Run under valgrind, as `instruction_count` does; ``python -m tokt_studies.speed.counted_run FOLDER``
alone runs the same, and counts nothing. At each cut it calls `os.getsid`, which nothing else calls:
before that callgrind writes down what it has counted, and begins at zero. What was counted between
two cuts belongs to the stage that was entered last, so that a stage has what it does itself,
without the stages that it calls.
"""

import gc
import json
import os
import platform
import socket
import subprocess
import sys
import sysconfig
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from tokt.features.common import atomic
from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.kernels.dispatch import KERNELS, Kernels
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.freshness.frozen_frames import StuckFrameDetector
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.monitoring.fixed_marks_watch import FixedMarksWatch
from tokt.inference.outputs.view_picture import ViewMoment, ViewState, fitted
from tokt.inference.policy.moving import MovingThings
from tokt.inference.policy.object_model import ObjectModel, detail_picture
from tokt.inference.policy.object_tracker import ObjectTracker
from tokt.inference.policy.policy import Judgement, SinglePolicy
from tokt.inference.policy.temporal_cues import TemporalCues
from tokt.inference.publisher import Observer, ReportPublisher
from tokt.inference.recording.run_log import RunLog
from tokt.inference.report import Report
from tokt.inference.sight import SightMeter
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import STATUS_WORDS
from tokt.models.bundle.bundle import Bundle, bundle_from_bytes

from .pictures_run import DefaultRun

CUT = "getsid"
"""The function of the C library that callgrind writes down its counts before."""
MODEL, PICTURES, SEGMENTS = "model.tokt", "pictures.npy", "segments.json"
"""Files in the folder of a count: what is run, on what, and the stages between cuts."""
WARM_UP = 6
"""Pictures that are not counted: tables are made, what fills itself is filled. The last one of them
fills the simulated caches: callgrind looks on from there, as all before would take it a minute."""
BOX = (0.35, 0.3, 0.3, 0.4)
"""Where in the first picture the object is that is held, in shares of its sides."""

START, LOOP, PUBLISH = "start", "loop", "publish"


class DrawnView(Observer):
    """The live view's picture of each frame, which a run has another process draw."""

    def __init__(self) -> None:
        self._state = ViewState(Limits().stale_s)

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Fit the frame's picture, and draw."""
        now, said = SYSTEM_CLOCK.monotonic(), report.verdict.status
        picture = None if frame.left is None else fitted(frame.left)
        shown = picture, judgement.mask, judgement.grid, judgement.held
        self._state.take(ViewMoment(report, now, now, ((now, said),), *shown))
        self._state.draw(self._state.shown(now), now)


STAGES: dict[str, tuple[tuple[type, str], ...]] = {
    "gray pictures": tuple(
        (Kernels, name) for name in ("resized_gray", "resized_gray16", "resized_grays")
    ),
    "frozen frames": ((StuckFrameDetector, "remove"), (StuckFrameDetector, "prepare")),
    "sight": ((SightMeter, "of"),),
    "quantize": ((Kernels, "quantize"), (Kernels, "summed_area")),
    "haralick": ((Kernels, "haralick_features"),),
    "lbp": ((Kernels, "lbp_counts"), (Kernels, "lbp_nearest_counts")),
    "lines": ((Kernels, "line_sums"),),
    "gradients": ((Kernels, "gradient_sums"), (Kernels, "structure_sums")),
    "box means": ((Kernels, "box_sums"), (Kernels, "level_counts")),
    "features": ((Bundle, "features"),),
    "decision": ((TextureDetector, "detect"), (SinglePolicy, "judge")),
    "flow": ((MovingThings, "judge"),),
    "anchor": ((ObjectTracker, "look"),),
    "temporal cues": ((TemporalCues, "judge"),),
    PUBLISH: ((ReportPublisher, "publish"),),
    "log": ((RunLog, "judged"),),
    "drift": ((DriftMonitor, "judged"),),
    "fixed marks": ((FixedMarksWatch, "judged"),),
    "view": ((DrawnView, "judged"),),
}
"""Of each stage the methods that it is; what is in none of them is `LOOP`. With `PUBLISH` a frame's
datagram is on its way."""


class Segment(NamedTuple):
    """What happened between two cuts."""

    stage: str
    sent: bool  # whether the frame's datagram was on its way


class Cuts:
    """Cut a run of pictures, and note of which stage each segment was.

    `vgdb` is the program by which callgrind takes orders; None where the run is not counted.
    """

    def __init__(self, vgdb: str | None = None) -> None:
        self.segments: list[Segment] = []
        self._vgdb = vgdb
        self._stages = [LOOP]
        self._counting = self._sent = False

    def pictures(self, pictures: U8) -> Iterator[U8]:
        """Each picture; counted is from the first one after `WARM_UP` on."""
        for place, picture in enumerate(pictures):
            if place == WARM_UP - 1:
                self._look_on()
            if place == WARM_UP:
                self._counting = True
                self._cut(START)
            elif self._counting:
                self._cut(LOOP)
            self._sent = False
            yield picture
        self._cut(LOOP)
        self._counting = False

    def method(self, stage: str, method: Callable[..., Any]) -> Callable[..., Any]:
        """The same method, with a cut where it begins and where it ends.

        One that a method of its own stage calls goes on uncut.
        """

        def cut_out(*arguments: Any, **named: Any) -> Any:
            if not self._counting or self._stages[-1] == stage:
                return method(*arguments, **named)
            self._cut(self._stages[-1])
            self._stages.append(stage)
            try:
                return method(*arguments, **named)
            finally:
                self._cut(self._stages.pop())
                self._sent |= stage == PUBLISH

        return cut_out

    def _look_on(self) -> None:
        """Have callgrind look on from now on."""
        if self._vgdb is None:
            return
        order = "--max-invoke-ms=0", f"--pid={os.getpid()}", "instrumentation", "on"
        with subprocess.Popen([self._vgdb, *order]) as asked:
            while asked.poll() is None:
                pass  # an order is seen by a program that runs, and by no other without ptrace
        if asked.returncode != 0:
            raise ToktError(f"{self._vgdb} ended with {asked.returncode}")

    def _cut(self, stage: str) -> None:
        self.segments.append(Segment(stage, self._sent))
        if sys.platform != "win32":  # nor is there valgrind
            os.getsid(0)


def code() -> dict[str, str]:
    """Facts of the code that ran: another one counts other instructions."""
    made = str(sysconfig.get_config_var("CONFIG_ARGS"))
    optimised = ", optimised" if "--enable-optimizations" in made else ""
    versions = machine()
    minor = f"{sys.version_info[0]}.{sys.version_info[1]}"
    return {
        "kernels": f"{KERNELS.name}, {KERNELS.detail}",
        "python": f"{minor}, {platform.python_compiler()}{optimised}",
        "libc": " ".join(platform.libc_ver()),
        **{name: str(versions[name]) for name in ("numpy", "opencv")},
    }


def main(folder: Path, vgdb: str | None = None) -> None:
    """Run the model of a folder on its pictures, and write down what it was, and the segments.

    `vgdb` is as in `Cuts`.
    """
    cv2.setNumThreads(1)
    bundle = bundle_from_bytes((folder / MODEL).read_bytes(), MODEL)
    pictures = np.load(folder / PICTURES)
    height, width = pictures.shape[1:3]
    cuts = Cuts(vgdb)
    for stage, methods in STAGES.items():
        for owner, name in methods:
            setattr(owner, name, cuts.method(stage, getattr(owner, name)))
    with closing(socket.socket(type=socket.SOCK_DGRAM)) as receiver:
        receiver.bind(("127.0.0.1", 0))
        run = DefaultRun(
            bundle,
            receiver.getsockname()[1],
            folder / "run.jsonl",
            held=ObjectModel(detail_picture(pictures[0]), BOX),
            others=[DrawnView()],
        )
        # As in `tokt run`; nor is what there is since then collected, here or there as it comes.
        gc.collect()
        gc.freeze()
        gc.disable()
        said = run.whole(cuts.pictures(pictures))
    counted = said[WARM_UP:]
    found = {
        "frame_size": f"{width}x{height} colour",
        "features": bundle.extractor.dim,
        "said": Counter(STATUS_WORDS[verdict.status] for verdict in counted),
        "object": Counter(verdict.anchor for verdict in counted),
        "code": code(),
        "segments": cuts.segments,
    }
    atomic.write_text(folder / SEGMENTS, json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
