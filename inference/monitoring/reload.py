"""Reloading: a store's new active model is made ready beside the running one, then exchanged.

::

    thread:  active pointer changed ──> child process: every check ──> build ──> newest frame
                                             │ refused                               │
                                             └─> told; the old one goes on           v
    loop:    frame, frame, frame ────────────────────────────────────> exchange ──> frame

All checks run in a process of their own: a bundle that hangs or crashes the one that loads it
costs that process, and the loop's frames do not wait for it. Then it judges the newest frame that
the running model judged: one made for another camera passes every other check.

No frame is there to judge at a start. A model that then finds `GOOD_FRAMES` in a row of the wrong
size gives way to the last good one, if that one judges the newest of them.
"""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tokt.features.common.errors import ToktError, os_words
from tokt.inference.clock import Clock
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.reason import Reason
from tokt.inference.report import Event, Report
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.history import Activation
from tokt.models.store.last_good import last_good, remember_good
from tokt.models.store.store import Store

POLL_S = 1.0
CHECK_S = 60.0
"""Seconds that the checks of a bundle may take."""
RETRY_S = 30.0
"""Seconds after which a refused one is looked at again: its file may have been made good."""
GOOD_FRAMES = 10
"""Frames that a model judges before its copy is the last good one; and frames in a row of the wrong
size after which it is taken for a model of another camera. One frame may be an odd one, as a camera
gives at its start; ten are over in a second or two."""


@dataclass(frozen=True)
class BundleCheck:
    """The child process's answer on the active bundle."""

    sha256: str  # of the one that was checked; empty where it is not known
    fault: str  # why it did not pass; empty where it did


def check_in_child(store: Store) -> BundleCheck:
    """Load a store's active bundle in another process, with every check."""
    command = [sys.executable, "-P", "-m", "tokt.models.store.check_active", str(store.path)]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=CHECK_S, check=False, stdin=subprocess.DEVNULL
        )
        answer = json.loads(done.stdout.splitlines()[-1])
        return BundleCheck(str(answer["sha256"] or ""), str(answer["fault"]))
    except subprocess.TimeoutExpired:
        return BundleCheck("", f"its checks did not end in {CHECK_S:g} s")
    except OSError as error:
        return BundleCheck("", f"its checks cannot be run: {os_words(error)}")
    except (ValueError, LookupError, TypeError):
        return BundleCheck("", f"its checks died with exit code {done.returncode}")


@dataclass(eq=False)
class ModelReloader(Observer):
    """Keep the running model the store's active one; it is told of every frame.

    `misfit` says why a bundle cannot take the running one's place, or an empty string, with a frame
    that it has to judge, or None. `put` puts a bundle into the policy, with what is not as it
    should be with it; the loop's thread calls it, between two frames.
    """

    store: Store
    running: Bundle | None  # the model at the start
    misfit: Callable[[Bundle, Frame | None], str]
    put: Callable[[Bundle, str], None]
    clock: Clock
    check: Callable[[Store], BundleCheck] = check_in_child
    is_active: bool = True  # whether `running` was loaded as the active one, not in its stead

    def __post_init__(self) -> None:
        # A copy of the active bundle has the same SHA-256; the active one may be made good.
        self._running = self.running.sha256 if self.running and self.is_active else ""
        self._to_remember = self.running
        self._judged = 0
        self._unfit = 0
        self._can_judge: Frame | None = None
        self._cannot_judge: tuple[Frame, str] | None = None
        self._refused: tuple[int, str] | None = None
        self._retry_at = 0.0
        self._fault = ""
        self._lock = threading.Lock()
        self._ready: tuple[Bundle, str] | None = None
        self._events: list[Event] = []
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tokt model", daemon=True)

    def start(self) -> None:
        """Look at the store from now on."""
        self._thread.start()

    def close(self) -> None:
        """Look no more; a check that is under way is not waited for."""
        self._stopped.set()

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Count what the running model could judge, and keep the newest frame that tells it."""
        self._judged += judgement.verdict.model is not None
        if judgement.features is not None:
            self._unfit, self._can_judge, self._cannot_judge = 0, frame, None
        elif judgement.verdict.reason in (Reason.WRONG_SIZE, Reason.NO_COLOUR):
            self._unfit += 1
            if self._unfit >= GOOD_FRAMES:
                self._can_judge, self._cannot_judge = None, (frame, judgement.verdict.health)

    def exchange(self) -> Sequence[Event]:
        """Put a new model that is ready into the policy; return what there is to tell."""
        with self._lock:
            ready, self._ready = self._ready, None
            events, self._events = self._events, []
            if ready is None:
                return events
            self._judged, self._unfit, self._cannot_judge = 0, 0, None
            bundle, note = ready
            self._to_remember = bundle
        self.put(bundle, note)
        words = f"model {bundle.label} runs from the next frame on"
        fields = {"label": bundle.label, "sha256": bundle.sha256}
        return [*events, Event(self.clock.time(), "model", words, fields)]

    def _run(self) -> None:
        while True:
            self._remember()
            if self._stopped.wait(POLL_S):
                return
            self.look()

    def look(self) -> None:
        """Look at the store once."""
        try:
            entry = self.store.active_entry()
        except ToktError as error:
            self._refuse(None, str(error))
            return
        if entry is None or entry.sha256 == self._running:
            self._refused, self._fault = None, ""
            if entry is not None:
                self._go_back(entry)
            return
        key = (entry.number, entry.sha256)
        if key == self._refused and self.clock.monotonic() < self._retry_at:
            return
        fault = self._make_ready(entry.sha256)
        if fault:
            self._refuse(key, f"model {entry.label} is refused: {fault}")

    def _make_ready(self, sha256: str) -> str:
        """Check a bundle and build it; why it cannot be used, or an empty string."""
        checked = self.check(self.store)
        if checked.sha256 not in ("", sha256):
            return ""  # another one has become active meanwhile: the next look is at that one
        if checked.fault:
            return checked.fault
        try:
            bundle = self.store.runnable(sha256, golden=False)
        except ToktError as error:
            return str(error)
        fault = self.misfit(bundle, self._can_judge)
        if not fault:
            with self._lock:
                self._ready = (bundle, "")
            self._running = sha256
            self._refused, self._fault = None, ""
        return fault

    def _go_back(self, active: Activation) -> None:
        """Put the last good model in the active one's place, if it alone can judge what comes."""
        with self._lock:
            # Until the loop has put the active one in, it is another that cannot judge.
            unjudged = None if self._ready else self._cannot_judge
        if unjudged is None or self.clock.monotonic() < self._retry_at:
            return
        self._retry_at = self.clock.monotonic() + RETRY_S
        frame, fault = unjudged
        try:
            bundle = last_good(self.store)
        except ToktError:
            return  # there is none, and the active one goes on saying unknown
        if bundle.sha256 == active.sha256 or self.misfit(bundle, frame):
            return
        note = f"model {active.label} cannot judge what this camera gives: {fault}"
        note += f"; the last good one runs instead: {bundle.label}, sha256 {bundle.sha256[:12]}"
        self._tell("model_refused", note)
        with self._lock:
            self._ready = (bundle, note)
        self._running, self._refused = "", (active.number, active.sha256)

    def _refuse(self, key: tuple[int, str] | None, fault: str) -> None:
        self._refused, self._retry_at = key, self.clock.monotonic() + RETRY_S
        if fault == self._fault:
            return
        self._fault = fault
        self._tell("model_refused", f"{fault}; the running model goes on")

    def _remember(self) -> None:
        with self._lock:
            if self._to_remember is None or self._judged < GOOD_FRAMES:
                return
            bundle, self._to_remember = self._to_remember, None
        fault = remember_good(self.store, bundle)
        if fault:
            self._tell("model_not_kept", fault)

    def _tell(self, name: str, words: str) -> None:
        with self._lock:
            self._events.append(Event(self.clock.time(), name, words))
