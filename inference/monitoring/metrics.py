"""Prometheus metrics: counters, histograms and states of a run.

A scrape reads what the loop has counted without any lock that the loop could wait for, and asks
each part for its own counters: nothing is counted twice.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from ipaddress import ip_address
from itertools import accumulate, chain
from socketserver import TCPServer
from typing import TYPE_CHECKING, Any

from tokt.features.common.address import (
    LOOPBACK_NAMES,
    is_addressed,
    parse_address,
    resolve,
    shown_host,
)
from tokt.features.common.errors import os_errors_as
from tokt.features.common.extras import needed_by
from tokt.inference.clock import Clock
from tokt.inference.publisher import Observer, Sender

from .run_counts import BOUNDS_S, CountingParts, Histogram, RunCounts

if TYPE_CHECKING:
    from prometheus_client import MetricsHandler
    from prometheus_client.metrics_core import Metric

    from .drift import DriftMonitor


LOOPBACK = "127.0.0.1"
_PREFIX = "tokt_"
_CAMERA_COUNTS = {
    "captured": "Captures delivered.",
    "incomplete": "Captures without a usable picture.",
    "left_out": "Exposures that never arrived.",
    "unpaired": "Captures that the other camera has none to.",
    "lost": "Times that the camera was lost.",
}

_BREATH_S = 0.0005
"""Between two metrics of a page, in real time: a frame that is judged meanwhile waits for the
writing of one or two metrics at most, and not for the whole page (1 ms)."""

Values = float | Mapping[Any, float]
"""One, or several by the value of the metric's label, or by a tuple of those of its labels."""


def parse_metrics(text: str) -> tuple[str, int]:
    """Read ``PORT``, for this computer only, or ``HOST:PORT``; ToktError if it is neither."""
    return parse_address(text if ":" in text else f"{LOOPBACK}:{text.strip()}")


@dataclass(eq=False)
class RunCollector:
    """Turn counts into metrics when asked: those of the run, and of its parts that count."""

    counts: RunCounts
    clock: Clock
    senders: Mapping[str, Sender] = field(default_factory=dict)  # by receiver
    parts: CountingParts = field(default_factory=CountingParts)
    drift: DriftMonitor | None = None
    faults: Mapping[str, str] = field(default_factory=dict)  # of the run's parts, by their names

    def collect(self) -> Iterator[Metric]:
        """All metrics, as they are now, one after the other."""
        said = (self._said(), self._state(), self._senders(), self._parts(), self._log())
        for metric in chain(*said, self._recorder(), self._cameras(), self._drift()):
            yield metric
            time.sleep(_BREATH_S)

    def _said(self) -> Iterator[Metric]:
        counts = self.counts
        yield _counter("verdicts", "Frames judged.", counts.verdicts, "status", "reason")
        words = "Unknown, said without a frame."
        yield _counter("heartbeats", words, counts.heartbeat_reasons, "reason")
        yield _counter("frames_missed", "Frames that were not judged.", counts.missed)
        yield _counter("frames_left_out", "Those there was no time for.", counts.left_out)
        words = "From when a frame was taken up to its verdict."
        yield _histogram("verdict_latency_seconds", words, counts.latency)
        words = "From a frame's arrival to its datagram."
        yield _histogram("datagram_age_seconds", words, counts.age)
        events = dict(counts.events)
        yield _counter("events", "What happened besides frames.", events, "event")
        yield _counter("model_switches", "New models put to work.", events.get("model", 0))
        words = "New models refused; the old one went on."
        yield _counter("model_refusals", words, events.get("model_refused", 0))

    def _state(self) -> Iterator[Metric]:
        counts = self.counts
        model, last = counts.model, counts.last_report
        if model is not None:
            name, _, version = model.label.rpartition("/")
            info: Values = {(name, version, model.sha256): 1.0}
            yield _gauge("model_info", "The model that runs.", info, "name", "version", "sha256")
        if last is not None:
            words = "What was said last: 1 obstacle, 0 clear, -1 unknown."
            yield _gauge("status", words, last.verdict.status)
        words = "Since something was last said, or since the start."
        # Before the clock is looked at: another may be published meanwhile.
        last_report_s = counts.last_report_s
        now = self.clock.monotonic()
        yield _gauge("last_verdict_age_seconds", words, now - last_report_s)
        yield _gauge("up_seconds", "Since the start.", now - counts.started_s)
        words = "The start, in seconds since 1970."
        yield _gauge("start_time_seconds", words, counts.started_t)

    def _senders(self) -> Iterator[Metric]:
        senders = dict(self.senders).items()  # a copy: one more may join meanwhile
        sent = {name: sender.sent for name, sender in senders}
        failed = {name: sender.failed for name, sender in senders}
        yield _counter("datagrams_sent", "Datagrams the system took.", sent, "receiver")
        yield _counter("datagrams_failed", "Datagrams it refused.", failed, "receiver")

    def _parts(self) -> Iterator[Metric]:
        failing = dict.fromkeys(dict(self.faults), 1.0)
        yield _gauge("part_failing", "A part of the run is not working.", failing, "part")

    def _log(self) -> Iterator[Metric]:
        if self.parts.log is not None:
            failed = self.parts.log.failed
            yield _counter("log_lines_failed", "Lines that could not be logged.", failed)

    def _recorder(self) -> Iterator[Metric]:
        recorder = self.parts.recorder
        if recorder is None:
            return
        writer = recorder.writer
        yield _counter("recorder_moments", "Moments opened.", recorder.clips)
        yield _counter("recorder_frames", "Frames recorded.", writer.frames)
        yield _counter("recorder_frames_dropped", "Frames that could not be.", writer.dropped)
        yield _counter("recorder_bytes", "Bytes recorded.", writer.written_bytes)
        words = "Bytes removed to make room."
        yield _counter("recorder_bytes_removed", words, writer.removed_bytes)
        yield _gauge("recorder_failing", "Frames are being left out.", bool(writer.fault))

    def _cameras(self) -> Iterator[Metric]:
        cameras = self.parts.cameras
        if cameras is None:
            return
        sides = list(zip(("left", "right"), cameras.counts, strict=False))
        for name, words in _CAMERA_COUNTS.items():
            values = {side: getattr(counts, name) for side, counts in sides}
            yield _counter(f"camera_{name}", words, values, "camera")
        drivers = zip(("left", "right"), cameras.drivers, strict=False)
        failures = {side: driver.failures for side, driver in drivers}
        yield _counter("camera_failures", "Captures lost to an error.", failures, "camera")
        back = self.counts.events.get("camera_back", 0)
        yield _counter("camera_reconnects", "Lost cameras that came back.", back)

    def _drift(self) -> Iterator[Metric]:
        drift = self.drift
        if drift is None:
            return
        state, distances = drift.state, drift.distances
        yield _gauge("drift_known", "The model tells what it learnt from.", state.known)
        yield _gauge("drift_out", "Drift was told and is not over.", state.out)
        if state.distance is not None and state.limit is not None:
            words = "Of the feature that is furthest out, from training."
            yield _gauge("drift_distance", words, state.distance)
            yield _gauge("drift_limit", "Distance at which it is out of range.", state.limit)
        yield _gauge("drift_feature_distance", "By feature.", distances, "feature")


def _counter(name: str, words: str, values: Values, *labels: str, gauge: bool = False) -> Metric:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    kind = GaugeMetricFamily if gauge else CounterMetricFamily
    metric = kind(_PREFIX + name, words, labels=labels)
    # A copy: the loop counts on meanwhile.
    by_label = dict(values) if isinstance(values, Mapping) else {(): float(values)}
    for key, value in by_label.items():
        metric.add_metric((key,) if isinstance(key, str) else key, value)
    return metric


_gauge = partial(_counter, gauge=True)


def _histogram(name: str, words: str, histogram: Histogram) -> Metric:
    from prometheus_client.core import HistogramMetricFamily

    bounds = [*map(str, BOUNDS_S), "+Inf"]
    counts = accumulate(list(histogram.counts))
    buckets = [(bound, float(n)) for bound, n in zip(bounds, counts, strict=True)]
    return HistogramMetricFamily(_PREFIX + name, words, buckets=buckets, sum_value=histogram.sum_s)


_REQUEST_S = 2.0  # longest silence of a client within its request, in seconds
_STOP_CHECK_S = 0.2
_JOIN_S = 1.0


class Metrics(Observer):
    """Serve a run's metrics until closed.

    One request at a time, each for a bounded silence of its client: whoever connects can keep other
    scrapes waiting, and nothing else. A request must name `host`, this computer or, elsewhere than
    on loopback, an address. `port` is the one that is listened on: for 0, any that was free.

    Raises ToktError if prometheus-client is not installed, or the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, collector: RunCollector) -> None:
        with needed_by("--metrics"):
            from prometheus_client import CollectorRegistry, ProcessCollector
        registry = CollectorRegistry()
        registry.register(collector)
        ProcessCollector(registry=registry)
        family, address = resolve(host, port)
        with os_errors_as(f"metrics cannot be served on {host}:{port}"):
            self._server = _QuietServer(family, address, _handler(registry, host, address[0]))
        self.port: int = self._server.server_address[1]
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="tokt metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer no more."""
        self._closing.set()
        self._thread.join(_JOIN_S)
        self._server.server_close()

    def _serve(self) -> None:
        while not self._closing.is_set():
            self._server.handle_request()


def _handler(registry: Any, host: str, address: str) -> type[MetricsHandler]:
    from prometheus_client import MetricsHandler

    names = LOOPBACK_NAMES | {shown_host(host), f"{shown_host(host)}.local"}
    is_local = ip_address(address).is_loopback

    class Handler(MetricsHandler):
        timeout = _REQUEST_S
        server_version, sys_version = "tokt", ""

        def do_GET(self) -> None:  # noqa: N802 - as `http.server` calls it
            hosts, port = self.headers.get_all("host", []), self.connection.getsockname()[1]
            if is_addressed(hosts, port, names, any_address=not is_local):
                super().do_GET()
            else:
                self.send_error(403, "This server is not addressed by that host name")

    Handler.registry = registry
    return Handler


class _QuietServer(TCPServer):
    """No HTTPServer, which looks the host's name up: a ship's network may take long for that."""

    allow_reuse_address = True
    timeout = _STOP_CHECK_S

    def __init__(self, family: socket.AddressFamily, address: Any, handler: Any) -> None:
        self.address_family = family
        super().__init__(address, handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that hang up or fall silent."""
