"""Metrics over real HTTP, read by Prometheus's own parser."""

import http.client
import socket
import sys
import time
import urllib.request
from types import SimpleNamespace
from typing import Any

import pytest

from tests.calls import refuses
from tests.inference.live import BROADCAST, refuse
from tests.inference.test_faults import hold_row
from tests.waiting import MAX_S
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.monitoring import metrics as metrics_module
from tokt.inference.monitoring.drift import DriftState
from tokt.inference.monitoring.metrics import Metrics, RunCollector, parse_metrics
from tokt.inference.monitoring.run_counts import CountingParts, RunCounts
from tokt.inference.outputs.udp import UdpSender
from tokt.inference.policy.policy import Judgement, SinglePolicy
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.run_log import RunLog
from tokt.inference.report import Event, Report
from tokt.inference.runtime import Runtime
from tokt.inference.sources.cameras.live_source import CameraCounts
from tokt.inference.sources.files import open_source
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import Verdict, unknown_verdict

parser = pytest.importorskip("prometheus_client.parser")


@pytest.fixture(autouse=True)
def soon_closed(monkeypatch):
    monkeypatch.setattr(metrics_module._QuietServer, "timeout", 0.02)
    monkeypatch.setattr(metrics_module, "_JOIN_S", 0.2)


@pytest.fixture
def serve():
    """Metrics on a free port."""
    opened: list[Metrics] = []

    def start(counts: RunCounts, clock: Any, **watched: Any) -> Metrics:
        opened.append(Metrics("127.0.0.1", 0, RunCollector(counts, clock, **watched)))
        return opened[-1]

    yield start
    for metrics in opened:
        metrics.close()


def scrape(metrics: Metrics) -> dict[tuple[str, ...], float]:
    """Every sample: (name, values of labels in the order of their names) -> value."""
    url = f"http://127.0.0.1:{metrics.port}/metrics"
    with urllib.request.urlopen(url, timeout=MAX_S) as answer:
        text = answer.read().decode()
    return {
        (sample.name, *(value for _, value in sorted(sample.labels.items()))): sample.value
        for family in parser.text_string_to_metric_families(text)
        for sample in family.samples
    }


def report(seq: int, verdict: Verdict, latency_ms: float | None = 12.0, **more: Any) -> Report:
    number = None if latency_ms is None else seq
    return Report(seq, number, 1.0, latency_ms, verdict, **more)


OBSTACLE = Verdict(1, 3, 4, None, 9.0, None, "texture", "reef/7")
DARK = unknown_verdict(Fault(Reason.DARK, "too dark"))
SILENT = unknown_verdict(Fault(Reason.STALE, "no frame"))


def test_a_run_s_numbers_are_all_there(
    make_mission, noise_scorer, receiver, closed_port, serve, tmp_path
):
    senders = {
        "here": UdpSender(*receiver.getsockname(), 2),
        "refused": UdpSender(BROADCAST, closed_port, 2),
    }
    refuse(senders["refused"])
    log = RunLog(tmp_path / "log.jsonl", "run-x")
    counts = RunCounts(SYSTEM_CLOCK)
    faults, parts = {"--record rec": "Not a directory"}, CountingParts(log=log)
    metrics = serve(counts, SYSTEM_CLOCK, senders=senders, parts=parts, faults=faults)
    before = scrape(metrics)
    assert ("tokt_status",) not in before and before["tokt_verdict_latency_seconds_count",] == 0
    folder = make_mission([[], [(4, 4)], [(1, 1)], []])
    (folder / "Left" / "t_L_4.jpg").write_bytes(b"no picture")
    source = open_source(str(folder), SYSTEM_CLOCK)
    policy = SinglePolicy(TextureDetector(noise_scorer))
    Runtime(source, policy, list(senders.values()), SYSTEM_CLOCK, [log, counts]).run()
    found = scrape(metrics)
    assert found["tokt_verdicts_total", "ok", "obstacle"] == 2
    assert found["tokt_verdicts_total", "ok", "clear"] == 1
    assert found["tokt_verdicts_total", "unreadable", "unknown"] == 1
    assert found["tokt_status",] == -1
    assert found["tokt_datagrams_sent_total", "here"] == 4
    assert found["tokt_datagrams_failed_total", "refused"] == 4
    assert found["tokt_datagrams_sent_total", "refused"] == 0
    assert found["tokt_log_lines_failed_total",] == 0
    assert found["tokt_part_failing", "--record rec"] == 1
    for name in ("verdict_latency", "datagram_age"):
        assert found[f"tokt_{name}_seconds_count",] == 4
        assert found[f"tokt_{name}_seconds_bucket", "+Inf"] == 4
        assert 0 < found[f"tokt_{name}_seconds_sum",] < 5
    assert 0 <= found["tokt_last_verdict_age_seconds",] <= found["tokt_up_seconds",]
    assert abs(found["tokt_start_time_seconds",] - time.time()) < 60
    if sys.platform == "linux":
        assert found["process_resident_memory_bytes",] > 1e6
    log.close()
    for sender in senders.values():
        sender.close()


def test_counters_by_reason_and_histograms_are_exact(hand_clock, serve):
    counts = RunCounts(hand_clock)
    metrics = serve(counts, hand_clock)
    frame = Frame(1, 1.0, None, None, missed=3)
    for latency_ms, verdict in ((1.0, OBSTACLE), (40.0, OBSTACLE), (9000.0, DARK)):
        said = report(1, verdict, latency_ms, age_ms=latency_ms + 10, left_out=2)
        counts.judged(frame, Judgement(verdict), said)
    gap = Frame(2, 1.0, None, None, missed=MANY_MISSED)
    counts.judged(gap, Judgement(DARK), report(4, DARK, 60.0))
    counts.heartbeat(report(5, SILENT, None))
    hand_clock.now += 2.5
    found = scrape(metrics)
    buckets = {"0.001": 1, "0.03": 1, "0.05": 2, "0.075": 3, "5.0": 3, "+Inf": 4}
    for le, count in buckets.items():
        assert found["tokt_verdict_latency_seconds_bucket", le] == count
    assert found["tokt_verdict_latency_seconds_sum",] == pytest.approx(9.101)
    assert found["tokt_datagram_age_seconds_count",] == 3
    assert found["tokt_verdicts_total", "dark", "unknown"] == 2
    assert found["tokt_heartbeats_total", "stale"] == 1
    # A gap that nobody can count is not made up.
    assert (found["tokt_frames_missed_total",], found["tokt_frames_left_out_total",]) == (9, 6)
    assert found["tokt_last_verdict_age_seconds",] == found["tokt_up_seconds",] == 2.5


def test_the_model_and_what_becomes_of_it(hand_clock, serve):
    counts = RunCounts(hand_clock)
    metrics = serve(counts, hand_clock)
    model = {"label": "reef/7", "sha256": "ab" * 32}
    counts.event(Event(0.0, "start", "", {"model": model}))
    assert scrape(metrics)["tokt_model_info", "reef", "ab" * 32, "7"] == 1
    counts.event(Event(0.0, "model", "", {"label": "a/b/8", "sha256": "cd" * 32}))
    counts.event(Event(0.0, "model_refused", "damaged"))
    found = scrape(metrics)
    assert found["tokt_model_info", "a/b", "cd" * 32, "8"] == 1
    assert ("tokt_model_info", "reef", "ab" * 32, "7") not in found
    assert (found["tokt_model_switches_total",], found["tokt_model_refusals_total",]) == (1, 1)
    assert found["tokt_events_total", "model_refused"] == 1
    counts.event(Event(0.0, "start", "", {"model": None}))
    assert not [key for key in scrape(metrics) if key[0] == "tokt_model_info"]


def test_what_other_parts_count_is_asked_of_them(hand_clock, serve):
    left, right = CameraCounts(incomplete=2), CameraCounts(captured=5, unpaired=4, lost=1)
    state = DriftState(True, True, 0.5, 0.25)
    counted = {"frames": 30, "dropped": 1, "written_bytes": 5000, "removed_bytes": 400}
    writer = SimpleNamespace(**counted, fault="the disk is full")
    cameras: Any = SimpleNamespace(
        counts=[left, right], drivers=[SimpleNamespace(failures=n) for n in (0, 3)]
    )
    drift = SimpleNamespace(state=state, distances={"lbp_3": 0.5, "lbp_4": 0.1})
    recorder: Any = SimpleNamespace(clips=2, writer=writer)
    parts = CountingParts(recorder=recorder, cameras=cameras)
    metrics = serve(RunCounts(hand_clock), hand_clock, parts=parts, drift=drift)
    found = scrape(metrics)
    assert found["tokt_camera_incomplete_total", "left"] == 2
    assert found["tokt_camera_unpaired_total", "right"] == 4
    assert found["tokt_camera_lost_total", "right"] == 1
    assert found["tokt_camera_failures_total", "right"] == 3
    assert found["tokt_camera_reconnects_total",] == 0
    assert (found["tokt_drift_distance",], found["tokt_drift_limit",]) == (0.5, 0.25)
    assert found["tokt_drift_feature_distance", "lbp_4"] == 0.1
    assert (found["tokt_drift_known",], found["tokt_drift_out",]) == (1, 1)
    assert (found["tokt_recorder_frames_total",], found["tokt_recorder_failing",]) == (30, 1)
    assert found["tokt_recorder_bytes_removed_total",] == 400


def test_what_is_said_while_a_page_is_written_is_not_said_in_the_future(hand_clock):
    counts = RunCounts(hand_clock)
    silence = unknown_verdict(Fault(Reason.NO_FRAME, "no frame has come yet"))
    ages = []
    for metric in RunCollector(counts, hand_clock).collect():
        if metric.name == "tokt_last_verdict_age_seconds":
            ages += [sample.value for sample in metric.samples]
        hand_clock.now += 1
        counts.heartbeat(Report(1, None, None, None, silence))
    assert ages == [0]


def test_clients_that_say_nothing_or_hang_up_stop_neither_the_server_nor_its_end(hand_clock, capfd):
    metrics = Metrics("127.0.0.1", 0, RunCollector(RunCounts(hand_clock), hand_clock))
    with socket.create_connection(("127.0.0.1", metrics.port)) as rude:
        rude.sendall(b"\x00\xff not HTTP\r\n\r\n")
    assert scrape(metrics)["tokt_up_seconds",] == 0
    with socket.create_connection(("127.0.0.1", metrics.port)):
        metrics.close()
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", metrics.port), timeout=1)
    assert capfd.readouterr().err == ""


def answer_of(port: int, host: str | None, method: str = "GET") -> tuple[int, str]:
    """The status and the Server header of an answer to who names that host."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=MAX_S)
    connection.putrequest(method, "/metrics", skip_host=True)
    if host is not None:
        connection.putheader("Host", host)
    connection.endheaders()
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status, str(answer.getheader("Server")).strip()


@pytest.mark.parametrize(
    ("served", "names", "others"),
    [
        ("127.0.0.1", ("127.0.0.1", "localhost", "LocalHost", "[::1]"), ("10.0.0.7", "rov")),
        ("localhost", ("127.0.0.1", "localhost"), ("10.0.0.7", "rov")),
        ("0.0.0.0", ("127.0.0.1", "10.0.0.7", "[fe80::1]", "rov", "rov.local"), ("rov.example",)),
    ],
)
def test_only_its_own_names_are_answered(hand_clock, monkeypatch, served, names, others):
    """A page whose name leads to this computer (DNS rebinding) reads nothing."""
    monkeypatch.setattr(socket, "gethostname", lambda: "ROV")
    metrics = Metrics(served, 0, RunCollector(RunCounts(hand_clock), hand_clock))
    port = metrics.port
    for name in names:
        assert answer_of(port, f"{name}:{port}") == (200, "tokt"), name
    for name in ("dive.example", "127.0.0.1.dive.example", "127.0.0.1,dive.example", *others):
        assert answer_of(port, f"{name}:{port}") == (403, "tokt"), name
    for host in (None, "", "localhost", f"localhost:{port + 1}", "[::1", f"localhost:{port},x:1"):
        assert answer_of(port, host) == (403, "tokt"), host
    assert answer_of(port, f"dive.example:{port}", "HEAD") == (501, "tokt")
    metrics.close()
    said = "refused with code 403; no version of Python is told"
    hold_row("metrics are asked for by another host name", said, "nothing")


def test_what_a_user_can_get_wrong(hand_clock, monkeypatch):
    assert parse_metrics("9108") == ("127.0.0.1", 9108)
    assert parse_metrics("0.0.0.0:9108") == ("0.0.0.0", 9108)
    for text in ("", "0", "70000", "here", "::"):
        refuses("not an address", parse_metrics, text)
    counts = RunCounts(hand_clock)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        served = ("127.0.0.1", port, RunCollector(counts, hand_clock))
        refuses(f"metrics cannot be served on 127.0.0.1:{port}", Metrics, *served)
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    refuses("needs prometheus_client: install the extra 'metrics'", Metrics, *served)
