"""The cases of whole processes: a table of features, a frame's way to a receiver, a start."""

import gc
import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import joblib
import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import Glcm, Join, Lbp, build_extractor
from tokt.features.frames.image_file import read_image
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.outputs.udp import UdpSender, decode, encode_v1
from tokt.inference.policy.policy import Judgement, Policy, SinglePolicy
from tokt.inference.runtime import Runtime
from tokt.inference.texture.detector import TextureDetector
from tokt_studies.baselines.thesis_texture import GRID, haralick_directions, judge, resized_gray

from . import launch
from .cases import Picture
from .haralick_agreement import HaralickAgreement
from .models import ModelPair, ThesisFeatureSet, all_haralick, all_lbp
from .paired_timing import BASELINE, FLOOR, OURS, Result, in_turns, result
from .pictures_run import FPS
from .stamped_receiver import StampedReceiver

_LBP = Lbp(10, 5, "patch")
_EXTRACTOR = Join([_LBP, Glcm(ignore_zeros=True)])
NAME = "latency.frame_to_udp"
_WARM_UP = 1
"""Rounds that are not counted."""
_PATIENT = Limits(stale_s=60.0, heartbeat_s=60.0)
"""A machine that is held up makes a frame late here, and not unknown."""


def library_features(file: Path) -> F64:
    """LBP (10, 5) and Haralick of one image file through the libraries."""
    cv2.setNumThreads(1)
    gray = resized_gray(read_image(file))
    return np.hstack([all_lbp(gray, 10, 5), all_haralick(gray)])


def tokt_features(file: Path) -> F64:
    """The same as `tokt.training.datasets.feature_cache` has it computed."""
    cv2.setNumThreads(1)
    return build_extractor(_EXTRACTOR.spec).describe(read_image(file), GRID)


def _decode(file: Path) -> int:
    cv2.setNumThreads(1)
    return read_image(file).size


def _agree(files: Sequence[Path], ours: list[Any], theirs: list[Any]) -> bool:
    """Whether LBP is the same and Haralick agrees with mahotas's."""
    agreement = HaralickAgreement()
    for file, mine, other in zip(files, ours, theirs, strict=True):
        if not np.array_equal(mine[:, : _LBP.dim], other[:, : _LBP.dim]):
            return False
        for row, patch in zip(mine, Picture(read_image(file)).patches, strict=True):
            agreement.add(row[_LBP.dim :], haralick_directions(patch, ignore_zeros=True))
    return agreement.agree


def measure_extraction(name: str, files: Sequence[Path], jobs: int, repetitions: int) -> Result:
    """Time the making of a feature table, several times; the times are of one image file.

    All processes (`jobs`) are started and warm before the first is timed.
    """

    def run(function: Callable[[Path], Any], chosen: Sequence[Path]) -> list[Any]:
        tasks = (joblib.delayed(function)(file) for file in chosen)
        return list(joblib.Parallel(n_jobs=jobs)(tasks))

    exact = _agree(files, run(tokt_features, files), run(library_features, files))
    ways = {BASELINE: library_features, OURS: tokt_features, FLOOR: _decode}
    calls = {way: partial(run, function) for way, function in ways.items()}
    times = in_turns(calls, [files], repetitions)
    a_file = {key: values / len(files) for key, values in times.items()}
    pace = {key: GRID.n_patches / float(np.median(values)) for key, values in a_file.items()}
    extras = {
        "of": "one image file to 100 rows of LBP (10,5) and Haralick",
        "floor_is": "reading and decoding alone, in as many processes",
        "files": len(files),
        "processes": jobs,
        "baseline_patches_per_s": pace[BASELINE],
        "ours_patches_per_s": pace[OURS],
    }
    return result(name, a_file, exact, extras)


@dataclass
class CameraPaced:
    """A live source that gives each of some pictures once, at `FPS`."""

    pictures: Sequence[Picture]
    first: int  # number of the first frame, and its time
    arrived: F64  # gets `time.monotonic` at each hand-over, by frame number
    live = True
    stopped = False

    def __iter__(self) -> Iterator[Frame]:
        """Each frame at its moment."""
        for place, picture in paced(self.pictures):
            if self.stopped:
                return
            number = self.first + place
            self.arrived[number] = time.monotonic()
            arrived = SYSTEM_CLOCK.monotonic()
            yield Frame(number, float(number), picture.frame, None, arrived=arrived)

    def stop(self) -> None:
        """Deliver no further frame."""
        self.stopped = True


@dataclass
class TimedPolicy:
    """A policy that notes how long each frame took it."""

    policy: Policy
    seconds: F64  # by frame number

    def judge(self, frame: Frame) -> Judgement:
        """Judge one frame."""
        start = time.monotonic()
        judgement = self.policy.judge(frame)
        self.seconds[frame.number] = time.monotonic() - start
        return judgement


def paced(pictures: Sequence[Picture]) -> Iterator[tuple[int, Picture]]:
    """Each with its place, at `FPS`, the first at once."""
    start = time.monotonic()
    for place, picture in enumerate(pictures):
        time.sleep(max(0.0, start + place / FPS - time.monotonic()))
        yield place, picture


def measure_latency(
    texture: ThesisFeatureSet, models: ModelPair, pictures: Sequence[Picture], rounds: int
) -> Result:
    """Both ways on the same frames, in turns: a round each of all that the runtime judges.

    A datagram that does not arrive is a `ToktError`.
    """
    size = (_WARM_UP + rounds) * len(pictures)
    arrived = {name: np.zeros(size) for name in (BASELINE, OURS)}
    judging_s = np.zeros(size)
    with _as_at_sea(), closing(StampedReceiver()) as receiver:
        for first in range(0, size, len(pictures)):
            source = CameraPaced(pictures, first, arrived[OURS])
            policy = TimedPolicy(SinglePolicy(TextureDetector(models.bundle)), judging_s)
            with closing(UdpSender("127.0.0.1", receiver.port, 2)) as sender:
                Runtime(source, policy, [sender], SYSTEM_CLOCK, limits=_PATIENT).run()
            with socket.socket(type=socket.SOCK_DGRAM) as plain:
                for place, picture in paced(pictures):
                    arrived[BASELINE][first + place] = time.monotonic()
                    judged = judge(picture.frame, texture.describe_patch, models.classifier)
                    plain.sendto(encode_v1(judged.verdict) or b"", ("127.0.0.1", receiver.port))
        heard = [(at, decode(data)) for at, data in receiver.heard()]
    counted = slice(_WARM_UP * len(pictures), None)
    times, said = {}, {}
    for name, version in ((OURS, 2), (BASELINE, 1)):
        mine = [(at, one) for at, one in heard if one["v"] == version]
        if len(mine) != size:
            raise ToktError(f"{NAME}: {len(mine)} of {size} datagrams arrived in time")
        times[name] = (np.array([at for at, _ in mine]) - arrived[name])[counted]
        said[name] = [(one["status"], one["x"], one["y"]) for _, one in mine]
    own = times[OURS] - judging_s[counted]
    extras = {
        "of": f"a frame's arrival to its datagram in another process, {FPS:g} frames a second",
        "baseline_is": "the thesis's way: judged patch by patch, and one v1 datagram",
        **_percentiles("ours", times[OURS]),
        **_percentiles("baseline", times[BASELINE]),
        **_percentiles("not_the_detector", own),
    }
    return result(NAME, times, said[OURS] == said[BASELINE], extras)


def _percentiles(name: str, seconds: F64) -> dict[str, Any]:
    found = np.percentile(seconds, (50, 99, 100)) * 1000
    places = ("median", "p99", "max")
    return {f"{name}_{at}_ms": ms for at, ms in zip(places, found.tolist(), strict=True)}


@contextmanager
def _as_at_sea() -> Iterator[None]:
    """The garbage collector as `tokt run` sets it: what there was before is not gone through."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class ProcessStart(NamedTuple):
    """One process's way to its first verdict."""

    seconds: float
    peak_mb: float | None
    said: tuple[Any, ...]  # status, x, y


def first_verdict(command: Callable[[int], list[str]], folder: Path) -> ProcessStart:
    """Start a program in a folder and wait for its datagram and its end.

    `command` gives its command line for a UDP port of 127.0.0.1. That it ends with an error, or
    sends nothing, is a `ToktError`.
    """
    with closing(StampedReceiver()) as receiver:
        line = [sys.executable, "-I", "-S", launch.__file__, *command(receiver.port)]
        ended = subprocess.run(line, stdout=subprocess.PIPE, text=True, cwd=folder, check=True)
        heard = receiver.heard()
    told = json.loads(ended.stdout)
    if told["code"] != 0 or not heard:
        raise ToktError(f"a process of the bench ended with {told['code']}: {told['error']}")
    arrived, datagram = heard[0]
    verdict = decode(datagram)
    said = (verdict["status"], verdict["x"], verdict["y"])
    return ProcessStart(arrived - told["started"], told["peak_mb"], said)


def measure_start(
    models: ModelPair, frame: bytes, suffix: str, folder: Path, rounds: int
) -> Result:
    """Time both processes, in turns, on the same frame, with models of LBP (10, 5).

    The frame is an image file, with the ending of its name; an empty folder is for it and the
    models. Each is started `rounds` times after one that is not counted.
    """
    source = folder / "source"
    source.mkdir(parents=True)
    picture, bundle, pickle = source / f"frame_1{suffix}", folder / "m.tokt", folder / "m.joblib"
    picture.write_bytes(frame)
    bundle.write_bytes(models.bundle.data)
    joblib.dump(models.classifier, pickle)

    def ours(port: int) -> list[str]:
        words = f"run --policy texture --format v2 --udp 127.0.0.1:{port}".split()
        files = ["--bundle", str(bundle), "--source", str(source)]
        return [sys.executable, "-m", "tokt", *words, *files]

    def baseline(port: int) -> list[str]:
        module = "tokt_studies.baselines.thesis_texture"
        return [sys.executable, "-m", module, str(pickle), str(picture), str(port)]

    pairs = [
        (first_verdict(baseline, folder), first_verdict(ours, folder)) for _ in range(rounds + 1)
    ][1:]
    starts = dict(zip((BASELINE, OURS), zip(*pairs, strict=True), strict=True))
    times = {way: np.array([one.seconds for one in each]) for way, each in starts.items()}
    memory = {f"{way}_mb": _median_mb(each) for way, each in starts.items()}
    said = {start.said for pair in pairs for start in pair}
    extras = {"of": "process start to first verdict, LBP (10,5)", **memory}
    return result("start", times, len(said) == 1, extras)


def _median_mb(starts: Sequence[ProcessStart]) -> float | None:
    peaks = [start.peak_mb for start in starts if start.peak_mb is not None]
    return float(np.median(peaks)) if peaks else None
