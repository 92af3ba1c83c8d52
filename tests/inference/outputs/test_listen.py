import json
import signal
import socket

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.inference.live import bound_socket, start_tokt
from tests.waiting import MAX_S
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.outputs.listen import (
    MAX_SENDERS,
    ReceivedDatagram,
    SenderMonitor,
    as_json,
    as_words,
    listen,
)
from tokt.inference.outputs.udp import encode_v2
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Report
from tokt.inference.verdict import Verdict, unknown_verdict

V1 = b"status : , 1  ,Xpos : ,-120,  Ypos : , -35 , meanValue : ,12.3456789012"


def v2(seq: int) -> bytes:
    verdict = Verdict(0, 0, 0, None, 0.0, None, "texture", "m/1")
    return encode_v2(Report(seq, seq, 0.0, 1.0, verdict))


# How a datagram comes: in its turn, after lost ones, anew, or overtaken.
FINE, ANEW, OLD = (0, False, False), (0, True, False), (0, False, True)


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ((1, 2, 5, 6), [FINE, FINE, (2, False, False), FINE]),
        ((57, 58), [FINE, FINE]),  # who comes later has lost nothing yet
        ((5000, 1, 2), [FINE, ANEW, FINE]),
        ((5000, 4, 5), [FINE, (3, True, False), FINE]),  # the new run's first ones are lost as well
        ((10, 12, 11, 12, 13), [FINE, (1, False, False), OLD, OLD, FINE]),
    ],
)
def test_gaps_are_lost_and_a_restart_or_an_overtaken_one_is_no_loss(numbers, expected):
    watch = SenderMonitor(0.0, None)
    heard = [watch.heard("a", v2(seq), 0.0) for seq in numbers]
    assert [(one.lost, one.restarted, one.overtaken) for one in heard] == expected


def test_v1_and_garbage_have_no_number():
    watch = SenderMonitor(0.0, None)
    assert watch.heard("a", V1, 0.0).lost is None
    assert watch.heard("a", v2(7), 0.0).lost == 0
    assert "error" in watch.heard("a", b"\x1b[2J garbage", 0.0).fields
    assert watch.heard("a", v2(8), 0.0).lost == 0


@given(st.sets(st.integers(1, 60), min_size=1))
def test_what_did_not_come_is_lost(arrived):
    watch = SenderMonitor(0.0, None)
    for seq in sorted(arrived):
        watch.heard("a", v2(seq), 0.0)
    assert watch.lost == max(arrived) - min(arrived) + 1 - len(arrived)


def test_silence_is_told_once_and_when_it_ends():
    watch = SenderMonitor(10.0, 1.5)
    assert watch.silences(11.4) == []
    (nobody,) = watch.silences(11.5)
    assert nobody.sender is None and watch.silences(13.0) == []
    watch.heard("a", v2(1), 20.0)
    watch.heard("b", v2(1), 21.0)
    assert [(one.sender, one.seconds) for one in watch.silences(22.0)] == [("a", 2.0)]
    assert [one.sender for one in watch.silences(23.0)] == ["b"]
    assert watch.silences(99.0) == []
    again = watch.heard("a", v2(2), 100.0)
    assert again.after_s == 80.0 and "after 80.0 s of silence" in as_words(again)
    assert watch.heard("a", v2(3), 100.1).after_s is None
    assert [one.sender for one in watch.silences(101.6)] == ["a"]


def test_many_senders_fill_no_memory():
    watch = SenderMonitor(0.0, 1.0)
    for number in range(MAX_SENDERS + 10):
        watch.heard(f"s{number}", v2(1), float(number) / 1000)
    silent = [one.sender for one in watch.silences(1e3)]
    assert len(silent) == MAX_SENDERS and silent[0] == "s10"


@given(st.text(max_size=40), st.text(max_size=20))
@example("\U00010000" * 40, "")
def test_no_sender_moves_the_cursor(health, model):
    verdict = Verdict(0, 0, 0, None, 0.0, None, "texture", model, health)
    sent = Report(1, 1, 0.0, 1.0, verdict)
    heard = SenderMonitor(0.0, None).heard("a", encode_v2(sent), 0.0)
    assert as_words(heard).isprintable()
    said = json.loads(as_json(heard))["health"]
    assert said == sent.fields()["health"] and health.startswith(said)  # a long text is cut


def test_a_line_says_what_was_odd():
    watch = SenderMonitor(0.0, None)
    unknown = unknown_verdict(Fault(Reason.DARK, "left: too dark"))
    first = watch.heard("1.2.3.4:5", encode_v2(Report(1, 1, None, 2.0, unknown, 3.0)), 0.0)
    assert as_words(first) == (
        "1.2.3.4:5  v2  unknown  seq=1  method=none  latency_ms=2.0  health=left: too dark  "
        "reason=dark  age_ms=3.0"
    )
    assert as_words(watch.heard("1.2.3.4:5", v2(5), 0.0)).endswith("[3 lost before it]")
    assert as_words(watch.heard("1.2.3.4:5", v2(4), 0.0)).endswith("[overtaken: old]")
    assert as_words(watch.heard("1.2.3.4:5", v2(1), 0.0)).endswith("[counts anew]")


def test_listen_hears_two_senders_on_a_real_socket(closed_port):
    heard: list[ReceivedDatagram] = []
    with bound_socket() as one, bound_socket() as two:

        def ready() -> None:
            for seq in (1, 2, 4):
                one.sendto(v2(seq), ("127.0.0.1", closed_port))
                two.sendto(v2(seq * 10), ("127.0.0.1", closed_port))

        watch = SenderMonitor(SYSTEM_CLOCK.monotonic(), None)
        where = ("127.0.0.1", closed_port)
        for event in listen(*where, watch, SYSTEM_CLOCK, lambda: len(heard) == 6, ready):
            assert isinstance(event, ReceivedDatagram)
            heard.append(event)
        mine = f"127.0.0.1:{one.getsockname()[1]}"
    assert [one.lost for one in heard if one.sender == mine] == [0, 0, 1]
    assert watch.lost == 1 + 9 + 19


def test_the_command_tells_silence_and_loss(closed_port):
    process = start_tokt("listen", "--port", closed_port, "--timeout", "0.3", "--json")
    assert "listening" in process.stderr.readline()
    nobody = json.loads(process.stdout.readline())
    assert nobody["from"] is None and nobody["silent_s"] >= 0.3
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for seq in (1, 4):
            sender.sendto(v2(seq), ("127.0.0.1", closed_port))
        address = f"127.0.0.1:{sender.getsockname()[1]}"
        shown = []
        # On a busy machine nobody may have been heard for so long once more, or between the two.
        while len(shown) < 3 or "silent_s" not in shown[-1]:
            shown += [json.loads(process.stdout.readline())]
            shown = [one for one in shown if one["from"] == address]
    heard = [one for one in shown if "silent_s" not in one]
    assert [one["lost"] for one in heard] == [0, 2] and shown[-1]["silent_s"] >= 0.3
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=MAX_S)
    assert (process.returncode, out, err) == (0, "", "missing: 2 datagrams\n")


def test_a_trend_is_shown_in_words():
    cues = {"trend": "growing", "trend_confidence": 0.962, "expansion_contact_s": 10.37}
    verdict = Verdict(1, 3, 4, None, 9.0, None, "texture", "m/1", **cues, anchor_size=-0.363)
    datagram = encode_v2(Report(1, 1, 0.0, 1.0, verdict))
    heard = SenderMonitor(0.0, None).heard("1.2.3.4:5", datagram, 0.0)
    told = "trend=growing  trend_confidence=0.962  expansion_contact_s=10.37  anchor_size=-0.363"
    assert as_words(heard).endswith(told)
    assert json.loads(as_json(heard))["anchor_x"] is None
