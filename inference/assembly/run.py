"""A run as its description says: checked, put together, run to its end, and its result.

What not every run asks for is imported where it is opened: after a crash each import is time in
which nothing is said.
"""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tokt.features.common.address import without_credentials
from tokt.features.common.errors import ToktError, counted
from tokt.features.common.held_files import changed_files
from tokt.features.common.terminal import print_json, real_stderr, say, stop_on_signal
from tokt.features.frames.mission import frame_size
from tokt.features.frames.view_mask import CameraMasks, joined
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig
from tokt.inference.monitoring.status_line import StatusLine
from tokt.inference.monitoring.watchdog import Notifier, restarts
from tokt.inference.publisher import TICK_S, Sender
from tokt.inference.reason import unknown_in_words
from tokt.inference.recording.run_start import ModelName, RunStart, software
from tokt.inference.report import START, Event, EventQueue
from tokt.inference.runtime import Runtime, Summary
from tokt.inference.sources.files import MissionSource
from tokt.inference.sources.open import is_camera_source
from tokt.inference.sources.stream import is_stream_source
from tokt.models.bundle.bundle import Bundle
from tokt.models.sight import sight_to_json

from .judging_parts import late_parts, policy_part, source_part
from .observer_parts import observer_parts, shadow_parts
from .option_checks import check_options
from .parts import DETECTOR, RECEIVER, SOURCE, Part
from .receiver_parts import receiver_parts
from .run_model import ModelExchange, open_model_watch
from .run_state import RunState

if TYPE_CHECKING:
    from tokt.inference.monitoring.reload import ModelReloader

FILE_CHANGED = "file_changed"
"""Event: a file that the run began with is another one now, or gone."""


def _words(summary: Summary, senders: Iterable[Sender]) -> str:
    """A run that has ended, in one line for people."""
    line = (
        f"{counted(summary.frames, 'frame')} in {summary.seconds:.1f} s: "
        f"{summary.obstacle} obstacle, {summary.clear} clear, {summary.unknown} unknown; "
        f"{counted(summary.sent, 'datagram')} sent"
    )
    if summary.send_failures:
        reasons = sorted({sender.last_error for sender in senders if sender.last_error})
        line += f", {summary.send_failures} refused ({', '.join(reasons)})"
    if summary.heartbeats or summary.dropped:
        late = counted(summary.dropped, "frame")
        line += f"; {counted(summary.heartbeats, 'heartbeat')}, no time for {late}"
    if summary.log_failures:
        line += f"; {summary.log_failures} log lines could not be written"
    return line


def _as_json(config: RunConfig, model: Bundle | None, summary: Summary) -> dict[str, Any]:
    """What ``--json`` prints of it; without a model its figures are None."""
    rule = model and model.operating_point.rule
    return {
        "policy": config.policy.policy,
        "format": config.outputs.format,
        "model": model and model.label,
        "frame_rule": rule and rule.to_json(),
        "latency_frames": rule and rule.latency_frames,
        **summary.to_json(),
    }


def run(config: RunConfig) -> Summary:
    """Run until the source ends or somebody stops it, and say what came of it.

    Only for the main thread: Ctrl-C and SIGTERM end the run. SIGTERM is ignored after either.

    Examples
    --------
    >>> options = {"source": "dive", "bundle": "tower-lbp-1.tokt", "log": "run.jsonl"}
    >>> tokt.run(tokt.RunConfig.of(options)).frames  # doctest: +SKIP
    246
    """
    again = restarts() > 0
    if not again:
        check_options(config)
    with ExitStack() as opened:
        state = RunState(config, config.monitoring.strict and not again, opened)
        notifier = opened.enter_context(closing(Notifier(SYSTEM_CLOCK)))
        assembler = _Assembler(state, notifier)
        runtime = assembler.runtime() if state.strict else None
        with stop_on_signal(state.stop) as signals:
            if not state.strict:
                runtime = assembler.runtime()
            notifier.ready()
            summary = Summary() if runtime is None else runtime.run()
            if not signals:  # a watchdog knows of its own, and starts again after anybody else's
                notifier.stopping()
        if signals:  # a watchdog asks, too, after a Ctrl-C: what ends is not to be cut off
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
    summary.heartbeats += state.heartbeats
    log = state.counting.log
    summary.log_failures = 0 if log is None else log.failed
    senders = state.senders.values()
    for line in (_words(summary, senders), *unknown_in_words(state.counts.unknown)):
        say(line)
    if config.monitoring.json:
        print_json(_as_json(config, state.model.bundle, summary))
    return summary


class _Assembler:
    """Put a run together from its parts."""

    def __init__(self, state: RunState, notifier: Notifier) -> None:
        self._state, self._notifier = state, notifier
        self._watch: ModelReloader | None = None
        self._status: StatusLine | None = None

    def runtime(self) -> Runtime | None:
        """Open all parts; ToktError where a strict start lacks one that it requires.

        Any other start sends unknown until there are a source and a detector. None where the run
        was stopped before that.
        """
        state = self._state
        if state.strict:
            self._add(receiver_parts(state))
            self._await(RECEIVER)
            self._add_detectors()
            self._add(observer_parts(state))
            return self._joined()
        self._show_status()
        with state.publisher.heartbeat_thread():
            self._add([*receiver_parts(state), *observer_parts(state)])
            self._await(RECEIVER)
            self._add_detectors()
            return self._joined()

    def _add(self, parts: Iterable[Part]) -> None:
        self._state.parts.add(parts)
        self._alive()

    def _await(self, kind: str) -> None:
        """Wait until a part of a required kind is working, or the run is stopped."""
        state = self._state
        if not state.parts.has(kind):
            self._notifier.ready()  # a service manager would take a long start for a failure
        while not (state.parts.has(kind) or state.stopped):
            self._alive()
            state.poll()
            SYSTEM_CLOCK.sleep(TICK_S)

    def _alive(self) -> None:
        self._notifier.alive()
        if self._notifier.dismissed:
            self._state.stop()

    def _add_detectors(self) -> None:
        self._add([source_part(self._state)])
        self._await(SOURCE)
        self._add([policy_part(self._state)])
        self._await(DETECTOR)
        if self._state.strict:
            _check_pictures(self._state)

    def _show_status(self) -> None:
        state = self._state
        if self._status is not None:
            return
        # Who writes to the terminal from now on writes across it.
        terminal = real_stderr()
        if terminal is not None and not terminal.isatty():
            terminal = None  # lines keep their order with those of others
        self._status = StatusLine(state.counts, SYSTEM_CLOCK, terminal, state.counting)
        state.observe(self._status)

    def _joined(self) -> Runtime | None:
        """Join source and policy, and add the parts that ask for both."""
        state, config, model = self._state, self._state.config, self._state.model
        source, assembly = state.source, state.assembly
        if source is None or assembly is None or state.stopped:
            return None
        state.publisher.live = source.live
        runtime = Runtime(
            source=source,
            policy=assembly.policy,
            senders=state.senders.values(),
            clock=SYSTEM_CLOCK,
            observers=state.observers,
            limits=config.limits,
            events=state.events,
            between=self._between,
            alive=self._alive,
            masks=state.masks_beside,
            publisher=state.publisher,
        )
        exchange = ModelExchange(model, assembly, state.drift, config.model.threads)
        self._add(late_parts(state, runtime, exchange))
        self._add(shadow_parts(state))
        for line in model.words():
            say(line)
        masks = runtime.masks or CameraMasks()
        _say_masks(state, masks)
        self._show_status()
        state.drift.set_model(model.bundle)
        if config.model.store is not None and assembly.texture is not None:
            self._watch = open_model_watch(config.model.store, model, exchange, state.opened)
            state.observers.append(self._watch)
        # On a thread: a disk that hangs keeps no verdict waiting.
        threading.Thread(target=_tell_changed_files, args=(state.events,), daemon=True).start()
        state.events.put(_start_event(state, masks))
        state.opened.callback(state.parts.close)  # before what they would join is closed
        # What was made up to here stays: the collector need not go through it at sea.
        gc.freeze()
        return runtime

    def _between(self) -> Sequence[Event]:
        self._state.parts.join()
        exchanged = () if self._watch is None else self._watch.exchange()
        return [*exchanged, *self._state.naming.take()]


def _tell_changed_files(events: EventQueue) -> None:
    for words in changed_files():
        events.put(Event(SYSTEM_CLOCK.time(), FILE_CHANGED, words))


def _say_masks(state: RunState, masks: CameraMasks) -> None:
    """Say what is no view in a run, and where that is not what one would expect."""
    beside, model = state.masks_beside, state.model.bundle
    if masks:
        say(masks.words())
    if beside and masks != beside:
        say("note: the mask beside the frames is not used: --mask says another one")
    if model is not None and model.masks and not masks and state.config.source.mask is None:
        say(
            f"WARNING: model {model.label} learnt from pictures with a mask, and this run has "
            f"none ({joined(model.masks).words()}). Use it with --mask model, or say --mask none"
        )


def _check_pictures(state: RunState) -> None:
    """Raise ToktError if a model cannot judge the pictures of a source.

    Or if recorded frames have another size than those that the options call sharp.
    """
    model, source = state.model, state.source
    if state.config.source.pixel_format == "Mono8" and model.bundle and model.bundle.needs_colour:
        label = model.bundle.label
        raise ToktError(f"model {label} looks at colours: not with --pixel-format Mono8")
    sight = model.sight
    if not sight or not isinstance(source, MissionSource):
        return
    try:
        width, height = frame_size(source.mission)
    except ToktError:
        return  # there is no frame to judge
    if (height, width) not in {(one.height, one.width) for one in sight}:
        raise ToktError(
            f"--sharp-frames has {sight[0].width}x{sight[0].height} frames, and the source's are "
            f"{width}x{height}: name frames of the same camera, of the same size"
        )


def _start_event(state: RunState, masks: CameraMasks) -> Event:
    """How the run begins, for the log."""
    config, model, named = state.config, state.model, state.config.source.source
    bundle = model.bundle
    is_kept = config.recording.log is not None or config.recording.record is not None
    is_path = not (is_camera_source(named) or is_stream_source(named))
    start = RunStart.of(
        config,
        # Whole paths: a replay begins somewhere else.
        source=str(Path(named).absolute()) if is_path else without_credentials(named),
        live=state.live,
        model=None if bundle is None else ModelName(bundle.label, bundle.sha256),
        model_fault=model.fault,
        model_note=model.note,
        stereo_fault=state.stereo_fault,
        masks=masks.to_json() if masks else None,
        sight=None if model.sight is None else sight_to_json(model.sight),
        frame_rule=None if bundle is None else bundle.operating_point.rule.to_json(),
        software=software() if is_kept else {},  # asking for versions takes a tenth of a start
    )
    again = restarts()
    words = f"tokt run on {without_credentials(named)}, policy {start.policy}"
    if again:
        words += f", started again by its watchdog ({again})"
    return Event(SYSTEM_CLOCK.time(), START, words, {**start.fields(), "restarts": again})
