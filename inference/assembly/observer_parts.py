"""The parts that look on at a run: its log, recording, metrics, live view and challenger."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING

from tokt.features.common.errors import UnavailableError
from tokt.features.common.terminal import say
from tokt.features.common.workspace import DEFAULT_WORKSPACE
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.monitoring.clock_watch import ClockWatch
from tokt.inference.monitoring.fixed_marks_watch import FixedMarksWatch
from tokt.inference.publisher import Observer

from .parts import Part
from .run_state import RunState

if TYPE_CHECKING:
    from tokt.inference.monitoring.metrics import Metrics
    from tokt.inference.outputs.view import LiveView
    from tokt.inference.recording.recorder import Recorder
    from tokt.inference.recording.run_log import RunLog
    from tokt.inference.replay.shadow import Shadow


def observer_parts(state: RunState) -> Iterator[Part]:
    """Yield the log, the recording and what else observes the run."""
    state.observers.append(FixedMarksWatch(SYSTEM_CLOCK, state.events.put))
    state.observers.append(ClockWatch(SYSTEM_CLOCK, state.events.put))
    openers: dict[str, Callable[[RunState], Observer]] = {
        "log": _open_log,
        "record": _open_recorder,
        "metrics": _open_metrics,
        "view": _open_view,
        "view_record": _open_video,
    }
    for option, opener in openers.items():
        if state.config.value(option) is not None:
            yield _observer_part(state, option, opener)


def shadow_parts(state: RunState) -> Iterator[Part]:
    """Yield the challenger, which comes last: in a replay without a rate the loop waits for it."""
    if state.config.model.shadow is not None:
        yield _observer_part(state, "shadow", _open_shadow)


def _observer_part(state: RunState, option: str, opener: Callable[[RunState], Observer]) -> Part:
    return Part(
        option=option,
        value=state.config.value(option),
        open=partial(opener, state),
        join=state.observe,
        fault=attrgetter("fault"),
        leave=partial(_take_out, state) if option == "shadow" else None,
    )


def _take_out(state: RunState, observer: Observer) -> None:
    """Stop passing frames to an observer, and close it on a thread, as that may take long."""
    state.observers.remove(observer)
    threading.Thread(target=observer.close, daemon=True).start()


def _open_log(state: RunState) -> RunLog:
    from tokt.inference.recording.log import LogRotation
    from tokt.inference.recording.run_log import RunLog

    recording = state.config.recording
    assert recording.log is not None
    rotation = LogRotation(recording.log_max_mb, recording.log_keep)
    state.counting.log = log = RunLog(
        path=recording.log,
        run=state.run_id,
        rotation=rotation,
        values=recording.log_values,
        live=state.live,
        tell=state.events.put,
    )
    return log


def _open_recorder(state: RunState) -> Recorder:
    from tokt.inference.recording.recorder import Recorder

    recording = state.config.recording
    assert recording.record is not None
    state.counting.recorder = recorder = Recorder(
        folder=recording.record,
        run=state.run_id,
        clock=SYSTEM_CLOCK,
        before_s=recording.record_before,
        after_s=recording.record_after,
        most_mb=recording.record_mb,
        tell=state.events.put,
    )
    return recorder


def _open_metrics(state: RunState) -> Metrics:
    from tokt.inference.monitoring.metrics import Metrics, RunCollector, parse_metrics

    assert state.config.monitoring.metrics is not None
    host, port = parse_metrics(state.config.monitoring.metrics)
    collector = RunCollector(
        counts=state.counts,
        clock=SYSTEM_CLOCK,
        senders=state.senders,
        parts=state.counting,
        drift=state.drift,
        faults=state.parts.faults,
    )
    return Metrics(host, port, collector)


def _open_view(state: RunState) -> LiveView:
    from tokt.features.common.address import kept_token
    from tokt.inference.outputs.view import LOOPBACK, LiveView, listening, view_url

    monitoring, token = state.config.monitoring, None
    assert monitoring.view is not None
    host = monitoring.view_host or LOOPBACK
    if monitoring.view_host is not None:
        token = kept_token(DEFAULT_WORKSPACE / "view-token")
    listener = listening(host, monitoring.view)
    say(f"view: {view_url(host, listener.getsockname()[1], token)}")
    stale_s = state.config.limits.stale_s
    return LiveView(listener, token, None, stale_s, state.events.put, state.naming)


def _open_video(state: RunState) -> LiveView:
    """Open a view of its own that nobody is served: a port that is taken costs no video."""
    from tokt.inference.outputs.view import LiveView

    record, stale_s = state.config.monitoring.view_record, state.config.limits.stale_s
    return LiveView(None, None, record, stale_s, state.events.put, state.naming)


def _open_shadow(state: RunState) -> Shadow:
    from tokt.inference.recording.log import JsonLines, LinesApart, LogRotation
    from tokt.inference.replay.replay import model_named
    from tokt.inference.replay.shadow import Challenger, Shadow

    config = state.config
    model, recording, assembly = config.model, config.recording, state.assembly
    assert model.shadow is not None and model.shadow_log is not None and assembly is not None
    if config.policy.policy == "either" and assembly.stereo is None:
        raise UnavailableError("policy either has no calibration yet")
    other = model_named(model.shadow)
    challenger = Challenger(
        label=other.label,
        sha256=other.sha256,
        data=other.data,
        policy=config.policy.policy,
        stereo=assembly.stereo,
        threads=model.threads,
        moving=config.policy.moving,
        sight=state.model.sight,
    )
    rotation = LogRotation(recording.log_max_mb, recording.log_keep)
    lines = (LinesApart if state.live else JsonLines)(model.shadow_log, rotation)
    return Shadow(challenger, lines, state.run_id, state.live, SYSTEM_CLOCK, state.events.put)
