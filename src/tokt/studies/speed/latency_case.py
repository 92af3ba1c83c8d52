"""From a frame's arrival to its datagram in another process, at a camera's rate."""

from __future__ import annotations

import gc
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.outputs.udp import UdpSender, encode_v1
from tokt.inference.policy.policy import Judgement, Policy, SinglePolicy
from tokt.inference.runtime import Runtime
from tokt.inference.texture.detector import TextureDetector
from tokt.studies.baselines.thesis_texture import judge

from .frames import Picture
from .models import ModelPair, ThesisFeatureSet
from .paired_timing import BASELINE, OURS, Result, result
from .stamped_receiver import StampedReceiver

NAME = "latency.frame_to_udp"
FPS = 15.0
"""Of the mission's cameras."""
_WARM_UP = 1
"""Rounds that are not counted."""
_PATIENT = Limits(stale_s=60.0, heartbeat_s=60.0)
"""A machine that is held up makes a frame late here, and not unknown."""


class CameraPaced:
    """A live source that gives each of some pictures once, at `FPS`.

    Parameters
    ----------
    pictures : sequence of Picture
    first : int
        Number of the first frame, and its time.
    arrived : array of float64
        Gets `time.monotonic` at each hand-over, by frame number.
    """

    live = True

    def __init__(
        self, pictures: Sequence[Picture], first: int, arrived: NDArray[np.float64]
    ) -> None:
        self._pictures = pictures
        self._first = first
        self._arrived = arrived
        self._stopped = False

    def __iter__(self) -> Iterator[Frame]:
        """Each frame at its moment."""
        for place, picture in paced(self._pictures):
            if self._stopped:
                return
            number = self._first + place
            self._arrived[number] = arrived = time.monotonic()
            yield Frame(number, float(number), picture.frame, None, arrived=arrived)

    def stop(self) -> None:
        """Deliver no further frame."""
        self._stopped = True


class TimedPolicy:
    """A policy that notes how long each frame took it.

    Parameters
    ----------
    policy : Policy
    seconds : array of float64
        By frame number.
    """

    def __init__(self, policy: Policy, seconds: NDArray[np.float64]) -> None:
        self._policy = policy
        self._seconds = seconds

    def judge(self, frame: Frame) -> Judgement:
        """Judge one frame."""
        start = time.monotonic()
        judgement = self._policy.judge(frame)
        self._seconds[frame.number] = time.monotonic() - start
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
    """Both ways on the same frames, in turns: a round of all frames each.

    Parameters
    ----------
    texture : ThesisFeatureSet
    models : ModelPair
        Of that texture.
    pictures : sequence of Picture
        Those that the runtime judges.
    rounds : int

    Raises
    ------
    ToktError
        If a datagram does not arrive.
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
            _baseline(texture, models, pictures, receiver.port, arrived[BASELINE][first:])
        heard = receiver.heard()
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


def _baseline(
    texture: ThesisFeatureSet,
    models: ModelPair,
    pictures: Sequence[Picture],
    port: int,
    arrived: NDArray[np.float64],
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for place, picture in paced(pictures):
            arrived[place] = time.monotonic()
            judged = judge(picture.frame, texture.describe_patch, models.classifier)
            sender.sendto(encode_v1(judged.verdict) or b"", ("127.0.0.1", port))


def _percentiles(name: str, seconds: NDArray[np.float64]) -> dict[str, Any]:
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
