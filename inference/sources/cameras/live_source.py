"""Live cameras as a source of frames.

::

    left driver ──> capture ─┐                 overtaken: counted, told as missed
                             ├─ Pairer ──> latest moment ──> frame
    right driver ─> capture ─┘     (one place, never a queue)

A camera's keeper starts it again for as long as it is lost. Meanwhile frames without its picture
go on coming, and say why: whoever judges them goes on saying unknown. A driver that hangs cannot be
started again, nor its thread be ended: then the source fails, and with it the program.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock, awake_s
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.report import Event

from .capture import LEFT, RIGHT, SIDES, CameraDriver, Capture
from .pairing import ClockFit, Moment, Pairer

HUNG_S = 40.0
"""Seconds in one call of a driver's after which it hangs: no opening takes that long."""

_MIN_PAUSE_S, _MAX_PAUSE_S = 0.2, 2.0  # until a lost camera is tried again: at first, and at most
_LOOK_S = 0.05  # how often a camera is looked after
_SILENT_PERIODS = 5
_MIN_SILENCE_S = 1.0
_FIRST_SILENCE_S = 3.0  # until there are two captures: a camera may take a second to begin
_DOUBT_S = 0.15  # of silence, after which the driver is asked whether its camera is there


class CameraKeeper(threading.Thread):
    """Keep one camera delivering, on a thread of its own.

    ::

        starting ──ToktError──> lost ──0.2, 0.4 .. 2 s──> starting
            │                    ^
            └──> delivering ─────┘  the driver says so, or nothing has come for too long

    The source is told what becomes of the camera, on the camera's own threads: by `captured` what
    it delivered, by `lost` why it delivers no more, at each attempt that fails. With `wait` a
    camera that cannot be opened at first is tried again, as one that was lost is. `tried` is set
    when it was opened or could not be; then `refused` says why.
    """

    def __init__(self, camera: int, driver: CameraDriver, source: CameraSource) -> None:
        super().__init__(name=f"tokt {SIDES[camera]} camera", daemon=True)
        self.driver = driver
        self.refused: ToktError | None = None
        self._camera = camera
        self._clock = source.clock
        self._source = source
        self._started_s = 0.0
        self._captured_s: float | None = None
        self._gap_s: float | None = None
        self._pause_s = _MIN_PAUSE_S
        self._call: tuple[str, float] | None = None
        self._is_lost = False
        self.tried = threading.Event()

    @property
    def hung(self) -> str:
        """Why its driver is not waited for any longer; empty as long as it may answer."""
        call = self._call
        if call is None or (seconds := awake_s(self._clock) - call[1]) <= HUNG_S:
            return ""
        return f"camera {self.driver.name} hangs: {call[0]} it has taken {seconds:.0f} s so far"

    @contextmanager
    def _calling(self, what: str) -> Iterator[None]:
        """A call of the driver's, which may never return."""
        self._call = what, awake_s(self._clock)
        try:
            yield
        finally:
            self._call = None

    def run(self) -> None:
        """Open the camera, and again when it is lost, until the end."""
        try:
            while not self._source.stopped:
                words = self._opened() or self._watched()
                self.tried.set()
                if self._source.stopped or self.refused:
                    return
                # Told before it is closed, which may hang; what still comes meanwhile is too late.
                self._is_lost = True
                self._source.lost(self._camera, words)
                with self._calling("closing"):
                    self.driver.stop()
                self._sleep(self._pause_s)
                self._pause_s = min(2 * self._pause_s, _MAX_PAUSE_S)
        finally:
            self.tried.set()
            with self._calling("closing"):
                self.driver.stop()

    def _opened(self) -> str:
        """Open the camera; why that cannot be, or nothing."""
        self._captured_s = self._gap_s = None
        self._is_lost = False
        try:
            with self._calling("opening"):
                self.driver.start(self._deliver)
        except ToktError as error:
            if not self.tried.is_set() and not self._source.wait:
                self.refused = error
            return str(error)
        self._started_s = awake_s(self._clock)
        self.tried.set()
        return ""

    def _deliver(self, capture: Capture) -> None:
        if self._is_lost:
            return
        captured_s = awake_s(self._clock)  # now: what queued came earlier, but comes
        if self._captured_s is not None:
            self._gap_s = captured_s - self._captured_s
        self._captured_s = captured_s
        self._pause_s = _MIN_PAUSE_S
        self._source.captured(capture)

    def _watched(self) -> str:
        """Look after a camera until it delivers no more; why."""
        words = ""
        while not self._source.stopped and not words:
            self._sleep(_LOOK_S)
            words = self._trouble()
        return words

    def _trouble(self) -> str:
        since = self._started_s if self._captured_s is None else self._captured_s
        silent_s = awake_s(self._clock) - since
        limit_s = _FIRST_SILENCE_S
        if self._gap_s is not None:
            limit_s = max(_MIN_SILENCE_S, _SILENT_PERIODS * self._gap_s)
        if silent_s > limit_s:
            return f"camera {self.driver.name} has sent nothing for {silent_s:.1f} s"
        if silent_s <= _DOUBT_S:
            return ""
        with self._calling("asking for"):
            return self.driver.lost()

    def _sleep(self, seconds: float) -> None:
        """Sleep in short pieces, so that `stop` is noticed."""
        until = self._clock.monotonic() + seconds
        while not self._source.stopped and (left_s := until - self._clock.monotonic()) > 0:
            self._clock.sleep(min(left_s, _LOOK_S))


_CHECK_S = 0.05  # how soon `stop` is noticed: a handler of a signal must not take a lock
_LOST_EVERY_S = 0.2  # between two frames that say that the left camera is lost
_JOIN_S = 5.0  # seconds that the drivers may take to close their cameras

_ONE_CAMERA = Fault(Reason.MISSING, "the source is one camera")
_NOTHING = Fault(Reason.MISSING, "no frame")


@dataclass
class CameraCounts:
    """Counts of one camera's captures."""

    captured: int = 0  # delivered by the driver, incomplete ones among them
    incomplete: int = 0  # without a usable picture
    left_out: int = 0  # exposures that never arrived, by the camera's own numbers
    unpaired: int = 0  # to which the other camera has none
    lost: int = 0  # times that the camera was lost


@dataclass(eq=False)
class CameraSource:
    """Frames of one camera, or of two that see the same moments.

    The first driver is the left camera's. Events ``camera_lost`` and ``camera_back`` are given to
    `on_event` on a camera's own thread. With `wait` cameras that are not there at the start are
    waited for. With `split` one camera's pictures hold the left view in their left half and the
    right view in the other.
    """

    live = True

    drivers: Sequence[CameraDriver]
    clock: Clock
    on_event: Callable[[Event], None]
    wait: bool = False
    split: bool = False

    def __post_init__(self) -> None:
        self.counts = [CameraCounts() for _ in self.drivers]
        self._keepers = [
            CameraKeeper(camera, driver, self) for camera, driver in enumerate(self.drivers)
        ]
        self._begun = self.stopped = False
        # All of these under the lock, which captures, keepers and the reader share.
        self._changed = threading.Condition()
        self._pairer = Pairer()
        self._lost: list[Fault] = [NO_FAULT for _ in self.drivers]
        self._latest: Moment | None = None
        self._skipped = 0
        self._gap = False
        # The reader's alone.
        self._number = 0
        self._last_at = math.nan

    def start(self) -> None:
        """Open the cameras; ToktError if one fails or hangs, unless they are to be waited for."""
        self._begun = True
        with ExitStack() as undo:
            # An interrupt while a camera opens closes it as well: its library's thread would go
            # on calling into a Python that is ending.
            undo.callback(self.close)
            for keeper in self._keepers:
                keeper.start()
            # One that is waited for keeps the others from nothing.
            for keeper in () if self.wait else self._keepers:
                while not keeper.tried.wait(_CHECK_S) and not keeper.hung:
                    pass
                if refused := keeper.refused or (keeper.hung and ToktError(keeper.hung)):
                    raise refused
            undo.pop_all()

    def stop(self) -> None:
        """Deliver no further frame, and close the cameras; may be called from a signal handler."""
        self.stopped = True

    def close(self) -> None:
        """Stop, and wait until the cameras are closed, though not for one that hangs."""
        self.stop()
        until = self.clock.monotonic() + _JOIN_S
        for keeper in self._keepers:
            if keeper.is_alive() and not keeper.hung:
                keeper.join(max(0.0, until - self.clock.monotonic()))

    def __iter__(self) -> Iterator[Frame]:
        """Deliver the latest frame, again and again, until `stop`.

        ToktError as from `start`, which it calls if nobody has, and if a driver hangs, be its
        camera to be waited for or not: only a new process frees it. RuntimeError if nobody looks
        after a camera any more: a mistake in this program.
        """
        if not self._begun:
            self.start()
        told_s = -math.inf
        try:
            while not self.stopped:
                frame = self._next(told_s)
                if frame is not None:
                    told_s = self.clock.monotonic()
                    yield frame
        finally:
            self.close()

    # What the keepers tell, on their threads.

    def captured(self, capture: Capture) -> None:
        """Take a capture."""
        camera = capture.camera
        if capture.fault and capture.fault.reason is Reason.CAMERA_LOST:
            self.lost(camera, capture.fault)  # its driver looks for it itself
            return
        with self._changed:
            counts, fit = self.counts[camera], self._fit(camera)
            if capture.picture is not None and (fault := fit.old(capture)):
                capture = replace(capture, picture=None, fault=fault, taken_s=math.nan)
            counts.captured += 1
            counts.incomplete += capture.picture is None
            if not math.isnan(capture.taken_s):
                counts.left_out += fit.add(capture)
            back, self._lost[camera] = bool(self._lost[camera]), NO_FAULT
            if len(self.counts) > 1:
                self._put(self._pairer.add(capture))
            else:
                at = fit.common_s(capture.taken_s, fit.shared)
                self._put([Moment(capture, None, NO_FAULT, at)])
        if back:
            self._tell("camera_back", camera, "back")

    def lost(self, camera: int, words: str) -> None:
        """A camera is gone."""
        with self._changed:
            first = not self._lost[camera]
            self._lost[camera] = Fault(Reason.CAMERA_LOST, words)
            self._put(self._pairer.absent(camera))
            self._gap |= camera == LEFT
            self.counts[camera].lost += first
        if first:
            self._tell("camera_lost", camera, f"lost: {words}")

    def _tell(self, name: str, camera: int, words: str) -> None:
        fields = {"camera": SIDES[camera], "name": self._keepers[camera].driver.name}
        words = f"the {SIDES[camera]} camera is {words}"
        self.on_event(Event(self.clock.time(), name, words, fields))

    def _fit(self, camera: int) -> ClockFit:
        """What is known of a camera's clock since it delivers; locked."""
        fit = self._pairer.fits[camera]
        if fit is None:
            driver = self._keepers[camera].driver
            fit = ClockFit(driver.period_s, driver.shared_clock)
            self._pairer.present(camera, fit)
        return fit

    def _put(self, moments: Sequence[Moment]) -> None:
        """The latest takes the place of the one before; locked."""
        for moment in moments:
            if moment.alone:
                camera = RIGHT if moment.left is None else LEFT
                self.counts[camera].unpaired += not self._lost[1 - camera]
            if self._latest is not None:
                self._skipped += 1
            self._latest = moment
        if moments:
            self._changed.notify()

    # What the reader does, on its thread.

    def _next(self, told_s: float) -> Frame | None:
        """The latest frame; None if it is time to look whether all is well."""
        # One that ended by itself is one that raised: its camera would never come back.
        for camera, keeper in enumerate(self._keepers):
            if not keeper.is_alive() and not self.stopped:
                raise RuntimeError(f"nobody looks after the {SIDES[camera]} camera any more")
            if keeper.hung:
                raise ToktError(f"{keeper.hung}; only a new start frees it")
        with self._changed:
            now = self.clock.monotonic()
            self._put(self._pairer.expired(now))
            if self._latest is None:
                due = self._pairer.due()
                wait_s = _CHECK_S if due is None else min(max(due - now, 0.0), _CHECK_S)
                self._changed.wait(wait_s)
            moment, self._latest = self._latest, None
            if self._lost[LEFT] and self.clock.monotonic() - told_s >= _LOST_EVERY_S:
                moment = moment or Moment(None, None, _NOTHING, math.nan)
            return None if moment is None else self._frame(moment)

    def _frame(self, moment: Moment) -> Frame:
        taken = [view for view in (moment.left, moment.right) if view is not None]
        t, captured_t = (taken[0].t, taken[0].captured_t) if taken else (self.clock.time(), None)
        arrived = min((view.arrived for view in taken), default=self.clock.monotonic())
        left, left_fault = self._view(LEFT, moment.left, moment.alone)
        right, right_fault = self._view(RIGHT, moment.right, moment.alone)
        if self.split:
            right_fault = self._view(LEFT, moment.left, moment.alone, RIGHT)[1]
            if left is not None:
                width = left.shape[1]
                left, right = left[:, : width // 2].copy(), left[:, width - width // 2 :].copy()
        missed = self._missed(moment.at)
        self._number += 1 + (missed if missed < MANY_MISSED else 0)
        views = left, right, left_fault, right_fault
        return Frame(self._number, t, *views, missed, True, arrived, captured_t)

    def _view(
        self, camera: int, capture: Capture | None, alone: Fault, shown: int | None = None
    ) -> tuple[U8 | None, Fault]:
        """A camera's picture, or why there is none; `shown` is the side, where that is another."""
        side = SIDES[camera if shown is None else shown]
        if capture is not None:
            fault = capture.fault.about(side) if capture.fault else NO_FAULT
            return capture.picture, fault
        if camera == len(self._lost):
            return None, _ONE_CAMERA
        return None, (self._lost[camera] or alone).about(side)

    def _missed(self, at: float) -> int:
        """How many frames between the last one delivered and this one were not."""
        skipped, self._skipped = self._skipped, 0
        last, self._last_at = self._last_at, at
        if self._gap:  # the left camera is lost, or has just come back
            self._gap = bool(self._lost[LEFT])
            return MANY_MISSED
        fits = (fit for fit in self._pairer.fits if fit is not None)
        periods = [fit.period_s for fit in fits if fit.period_s is not None]
        if math.isnan(at - last) or not periods:
            return skipped
        return max(skipped, round(min((at - last) / min(periods) - 1, MANY_MISSED)))
