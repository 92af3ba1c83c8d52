"""The process in which a challenger judges: whatever becomes of it, the runtime goes on.

A process and not a thread, by measurement: beside a challenger that is always busy the running
model's median latency was 1.4 to 2 times as long where they shared one interpreter, and 0.9 to 1.2
times with processes (docs/replay.md). And a process may crash, hang or be killed. Pictures come
through a pipe: a process that writes to shared memory where the disk of it is full is ended.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import Assembly, StereoSetup, assemble
from tokt.inference.policy.policy import Policy
from tokt.inference.report import Report
from tokt.models.bundle.bundle import Bundle, bundle_from_bytes

Result = TypeVar("Result")

READY = "ready"
NICENESS = 10
"""The running model comes first where both want the processor."""


@dataclass(frozen=True)
class Challenger:
    """A challenger: the run's policy with another model, judging in a process of its own.

    Parameters
    ----------
    label : str
        ``name/version``.
    sha256 : str
    data : bytes
        The bundle file.
    policy : str
    stereo : StereoSetup or None
    threads : int

    Raises
    ------
    ToktError
        If the policy uses no model.
    """

    label: str
    sha256: str
    data: bytes
    policy: str
    stereo: StereoSetup | None = None
    threads: int = 1

    def __post_init__(self) -> None:
        if self.policy == "disparity":
            raise ToktError("policy disparity uses no model: a challenger cannot differ (--shadow)")

    @classmethod
    def of(
        cls, bundle: Bundle, policy: str, stereo: StereoSetup | None = None, threads: int = 1
    ) -> Challenger:
        """A bundle as a challenger in a run of that policy."""
        return cls(bundle.label, bundle.sha256, bundle.data, policy, stereo, threads)

    def assemble(self) -> Assembly:
        """The policy.

        Raises
        ------
        ToktError
            If it cannot be put together, or the bundle fails a check.
        """

        def load() -> Bundle:
            return bundle_from_bytes(self.data, self.label)

        return assemble(self.policy, load, self.stereo, self.threads, _Untimed())


class _Untimed:
    """Never late: how long a challenger takes behind the running model is told, and no fault."""

    def took(self, call: Callable[[], Result]) -> tuple[Result, float]:
        """Call it; what it gave, and no time."""
        return call(), 0.0


def serve(challenger: Challenger, connection: Connection) -> None:
    """Judge the frames that come until there are no more; what the process runs."""
    # Who started it ends it, when the pipe closes.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    cv2.setNumThreads(1)
    try:
        policy = challenger.assemble().policy
    except ToktError as error:
        connection.send(str(error))
        return
    try:
        connection.send(READY)
        while True:
            _answer(policy, connection)
    except (EOFError, OSError):
        return  # no more frames, or nobody who hears the answer


def _answer(policy: Policy, connection: Connection) -> None:
    frame = receive_frame(connection)
    start = time.perf_counter()
    verdict = policy.judge(frame).verdict
    latency_ms = 1000 * (time.perf_counter() - start)
    connection.send(Report(0, frame.number, frame.t, latency_ms, verdict).fields())


def send_frame(connection: Connection, frame: Frame) -> None:
    """Pass a frame on to `receive_frame` at the other end."""
    pictures = [frame.left, frame.right]
    looks = [None if each is None else (each.shape, each.dtype.str) for each in pictures]
    connection.send((replace(frame, left=None, right=None), looks))
    for picture in pictures:
        if picture is not None and picture.size:
            connection.send_bytes(np.ascontiguousarray(picture).reshape(-1).view(np.uint8).data)


def receive_frame(connection: Connection) -> Frame:
    """The next frame.

    Raises
    ------
    EOFError, OSError
        If the other end is gone.
    """
    frame: Frame
    frame, looks = connection.recv()
    left, right = (None if look is None else _picture(connection, *look) for look in looks)
    return replace(frame, left=left, right=right)


def _picture(connection: Connection, shape: tuple[int, ...], dtype: str) -> NDArray[np.uint8]:
    picture: NDArray[np.uint8] = np.empty(shape, dtype)
    if picture.size:
        connection.recv_bytes_into(picture.reshape(-1).view(np.uint8).data)
    return picture
