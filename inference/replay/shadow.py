"""A challenger on the same frames as the running model: logged and compared, never sent.

::

    loop ──> latest frame ──> thread ──pipe──> process: the same policy, another model
             (never a queue)    │ <──verdict──────┘
                                └──> a line with both verdicts

In real time a frame that comes while the challenger is busy waits, and one that is overtaken by
the next is left out and counted; otherwise the loop waits for the challenger, and it judges every
frame. The running model's verdict is out before the challenger hears of the frame.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

import cv2

from tokt.features.common.errors import ToktError, os_words
from tokt.inference.clock import Clock, FixedStopwatch, awake_s
from tokt.inference.config import NEAR
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import Assembly, StereoSetup, assemble
from tokt.inference.policy.policy import Judgement, Policy
from tokt.inference.publisher import Observer
from tokt.inference.recording.log import JsonLines, LinesApart
from tokt.inference.report import Event, Report
from tokt.inference.verdict import UNKNOWN
from tokt.models.bundle.bundle import Bundle, bundle_from_bytes
from tokt.models.sight import SightLimits

READY = "ready"
NICENESS = 10
"""The running model comes first where both want the processor."""


@dataclass(frozen=True)
class Challenger:
    """A challenger: the run's policy with another model, judging in a process of its own.

    ToktError if the policy uses no model.
    """

    label: str  # ``name/version``
    sha256: str
    data: bytes  # the bundle file
    policy: str
    stereo: StereoSetup | None = None
    threads: int = 1
    moving: str = NEAR
    sight: tuple[SightLimits, ...] | None = None  # as `RunModel` has it

    def __post_init__(self) -> None:
        if self.policy == "disparity":
            raise ToktError("policy disparity uses no model: a challenger cannot differ (--shadow)")

    def assemble(self) -> Assembly:
        """The policy; ToktError if it cannot be put together, or the bundle fails a check."""

        def load() -> Bundle:
            bundle = bundle_from_bytes(self.data, self.label)
            return bundle if self.sight is None else bundle.with_sight(self.sight)

        # Never late: how long it takes behind the running model is told, and no fault.
        return assemble(
            *(self.policy, load, self.stereo, self.threads, FixedStopwatch()), moving=self.moving
        )


def serve(challenger: Challenger, connection: Connection) -> None:
    """Judge the frames that come until there are no more; what the process runs.

    A process and not a thread, by measurement: beside a challenger that is always busy the running
    model's median latency was 1.4 to 2 times as long where they shared one interpreter, and 0.9 to
    1.2 times with processes (replay.md). And a process may crash, hang or be killed. Pictures
    come through a pipe: a process that writes to shared memory where the disk of it is full is
    ended.
    """
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
    """Pass a frame on to `receive_frame` at the other end, its pictures without a copy."""
    pictures: list[pickle.PickleBuffer] = []
    # A copy, without what was covered in it here.
    rest = pickle.dumps(replace(frame), protocol=5, buffer_callback=pictures.append)
    connection.send((rest, [picture.raw().nbytes for picture in pictures]))
    for picture in pictures:
        connection.send_bytes(picture.raw())


def receive_frame(connection: Connection) -> Frame:
    """The next frame; raises EOFError or OSError if the other end is gone."""
    rest, sizes = connection.recv()
    pictures = [bytearray(size) for size in sizes]
    for picture in pictures:
        connection.recv_bytes_into(picture)
    frame: Frame = pickle.loads(rest, buffers=pictures)
    return frame


SHADOW_FORMAT = 1
"""Of a shadow log's lines; its start line carries it. To change it: raise this, keep reading the
older ones, and prove it with a test."""
START, FAILED, END = "start", "failed", "end"
COMPARED = ("status", "reason", "mean", "x", "y", "distance_m", "method", "model", "latency_ms")
"""What a line has of either verdict."""

ANSWER_S = 30.0
"""Seconds after which a challenger that does not answer, or start up, is taken for hung; where it
is to judge every frame the loop waits for it as long."""
_CLOSE_S = 2.0


@dataclass(frozen=True)
class _Waiting:
    """A frame that the challenger has not heard of."""

    frame: Frame
    said: dict[str, Any]
    dropped: int


@dataclass(eq=False)
class Shadow(Observer):
    """Let a challenger judge what the running model judges.

    `tell` takes events, from another thread: ``shadow_failed``, and ``shadow_differs`` where the
    two begin to differ, unknowns left aside.
    """

    challenger: Challenger
    log: JsonLines | LinesApart  # for this run's lines only; closed by `close`
    run: str  # its id
    live: bool  # whether frames come in real time
    clock: Clock
    tell: Callable[[Event], None]

    def __post_init__(self) -> None:
        self.judged_frames = self.dropped = 0  # frames it judged, and was too slow for
        self.fault = ""  # why it judges no more
        self._differs = False
        self._changed = threading.Condition()
        self._waiting: _Waiting | None = None
        self._busy_since: float | None = awake_s(self.clock)
        self._ended = False
        model = {"label": self.challenger.label, "sha256": self.challenger.sha256}
        begins = {"event": START, "format_version": SHADOW_FORMAT, "t": self.clock.time()}
        judges = {"policy": self.challenger.policy, "challenger": model, "live": self.live}
        self.log.write({**begins, "run": self.run, **judges})
        spawning = multiprocessing.get_context("spawn")
        self._connection, theirs = spawning.Pipe()
        self._process = spawning.Process(
            target=serve, args=(self.challenger, theirs), name="tokt shadow", daemon=True
        )
        self._thread = threading.Thread(
            target=self._run_challenger, args=(theirs,), name="tokt shadow", daemon=True
        )
        self._thread.start()

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Pass the frame on, if the challenger is to hear of it."""
        said = report.fields()
        with self._changed:
            self._await_turn()
            if self.fault:
                return
            overtaken, dropped = self._waiting, 0
            if overtaken is not None:
                self.dropped += 1
                dropped = overtaken.dropped + 1
                frame = replace(frame, missed=frame.missed + overtaken.frame.missed + 1)
            self._waiting = _Waiting(frame, said, dropped)
            self._changed.notify_all()

    def _await_turn(self) -> None:
        """Wait until no frame waits, but not in real time; end a challenger that is hung."""
        if self.live:
            since = self._busy_since
            hung = since is not None and awake_s(self.clock) - since > ANSWER_S
        else:
            ready = self._changed.wait_for(lambda: not self._waiting or bool(self.fault), ANSWER_S)
            hung = not ready
        if hung:
            self._fail(f"it does not answer for {ANSWER_S:g} s")
            self._kill()

    def close(self) -> None:
        """End the challenger: after its last frame where it judges every one, else at once."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join(_CLOSE_S if self.live else ANSWER_S)
        if self._thread.is_alive():
            self._fail("it did not answer when the run ended")
            self._kill()
            self._thread.join(_CLOSE_S)
        self.log.write({"event": END, "run": self.run, "dropped": self.dropped})
        self.log.close()

    def _run_challenger(self, theirs: Connection) -> None:
        """What the thread does: ask for each frame's verdict, until the run or the process ends."""
        try:
            self._process.start()
        except OSError as error:
            self._connection.close()
            self._fail(f"its process cannot be started: {os_words(error)}")
            return
        finally:
            theirs.close()
        try:
            answer = self._connection.recv()
            if answer != READY:
                self._fail(str(answer))
            while not self.fault and (waiting := self._next()) is not None:
                send_frame(self._connection, waiting.frame)
                self._compare(waiting, self._connection.recv())
        except (EOFError, OSError):
            self._process.join(_CLOSE_S)
            self._fail(f"its process ended with exit code {self._process.exitcode}")
        finally:
            self._connection.close()
            self._process.join(_CLOSE_S)
            self._kill()  # Python would wait at its end for one that is still there

    def _next(self) -> _Waiting | None:
        """The frame that waits, waiting for one; None when there will be no more."""
        with self._changed:
            self._busy_since = None
            self._changed.wait_for(lambda: self._waiting is not None or self._ended)
            self._busy_since = awake_s(self.clock)
            waiting, self._waiting = self._waiting, None
            self._changed.notify_all()
            return waiting

    def _compare(self, waiting: _Waiting, answer: dict[str, Any]) -> None:
        """Write both verdicts down."""
        self.judged_frames += 1
        said, number = waiting.said, waiting.frame.number
        line = {"run": self.run, "seq": said["seq"], "frame": number, "t": said["t"]}
        line["dropped"] = waiting.dropped
        for side, judged in (("champion", said), ("challenger", answer)):
            line[side] = {name: judged[name] for name in COMPARED}
        self.log.write(line)
        statuses = said["status"], answer["status"]
        differs = statuses[0] != statuses[1] and UNKNOWN not in statuses
        if differs and not self._differs:
            words = f"challenger {self.challenger.label} says otherwise at frame {number}"
            fields = {"frame": number, "champion": statuses[0], "challenger": statuses[1]}
            self.tell(Event(self.clock.time(), "shadow_differs", words, fields))
        self._differs = differs

    def _kill(self) -> None:
        if self._process.pid is not None:
            self._process.kill()

    def _fail(self, why: str) -> None:
        with self._changed:
            if self.fault:
                return
            self.fault, self._waiting = why, None
            self._changed.notify_all()
            words = f"challenger {self.challenger.label} judges no more: {why}"
            failed = {"event": FAILED, "run": self.run, "t": self.clock.time(), "words": why}
            self.log.write(failed)
            self.tell(Event(self.clock.time(), "shadow_failed", words))
