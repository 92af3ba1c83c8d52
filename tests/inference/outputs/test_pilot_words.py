"""Words and figures for the pilot, decoded by pymavlink from a real socket."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.inference.outputs.test_mavlink import AHEAD, DARK, LEFT, RIGHT, seen, sender_over
from tokt.inference.links.datagrams import UdpLink
from tokt.inference.outputs.pilot_words import ENDED, PilotWords, text_of
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Report
from tokt.inference.verdict import Verdict, unknown_verdict

common = pytest.importorskip("pymavlink.dialects.v20.common")

CLEAR, OBSTACLE = seen(None), seen(AHEAD)
WARNING, INFO = common.MAV_SEVERITY_WARNING, common.MAV_SEVERITY_INFO


def test_what_is_said():
    assert text_of(CLEAR) == "tokt: clear"
    assert text_of(seen(LEFT)) == "tokt: obstacle on the left"
    assert text_of(seen(RIGHT, "disparity", 4.56)) == "tokt: obstacle on the right, 4.6 m"
    assert text_of(seen(AHEAD, "disparity", math.nan)) == "tokt: obstacle ahead"
    assert text_of(Verdict(1, None, None, None, 9.0, 3.0, "disparity", None)) == (
        "tokt: obstacle in view, 3.0 m"
    )
    assert text_of(DARK) == "tokt: unknown, dark"


@given(st.sampled_from(Reason), st.floats())
def test_every_line_fits_and_is_ascii(reason, distance_m):
    for verdict in (
        unknown_verdict(Fault(reason, "x" * 400)),
        seen(RIGHT, "disparity", distance_m),
    ):
        assert text_of(verdict).isascii() and len(text_of(verdict)) <= 50


def told(verdicts, step_s):
    """The seconds and statuses at which words are due."""
    words = PilotWords()
    said = []
    for at, verdict in enumerate(verdicts):
        if words.due(verdict, at * step_s) is not None:
            said.append((round(at * step_s, 3), verdict.status))
    return said


def test_only_changes_are_told():
    assert told([CLEAR] * 50 + [OBSTACLE] * 50 + [DARK] * 50, 0.125) == [
        (0.0, 0),
        (6.25, 1),
        (12.5, -1),
    ]


def test_an_obstacle_does_not_wait_and_the_newest_state_is_told_in_the_end():
    verdicts = [CLEAR, OBSTACLE, *[CLEAR] * 20]
    assert told(verdicts, 0.125) == [(0.0, 0), (0.125, 1), (2.125, 0)]
    reasons = [unknown_verdict(Fault(reason, "")) for reason in (Reason.DARK, Reason.STALE)]
    assert told([reasons[0], *[reasons[1]] * 20], 0.125) == [(0.0, -1), (2.0, -1)]


def test_a_flicker_does_not_flood():
    said = told([CLEAR, OBSTACLE] * 400, 0.125)  # 100 s
    assert 50 <= len(said) <= 100
    assert len([at for at, status in said if status == 1]) <= 51


def messages(receiver, sender, reports):
    """What a sender says of these verdicts, up to its end."""
    for seq, (verdict, wait) in enumerate(reports):
        sender.send(Report(seq, seq, 0.0, 1.0, verdict))
        wait()
    sender.close()
    parser, said = common.MAVLink(None), []
    while not said or getattr(said[-1], "text", "") != ENDED:
        said += parser.parse_buffer(receiver.recv(4096))
    return said


def figures(said):
    return [(one.name, one.value) for one in said if one.get_type() == "NAMED_VALUE_FLOAT"]


def test_lines_have_the_severity_that_stations_read_aloud(receiver, hand_clock):
    sender = sender_over(UdpLink(*receiver.getsockname()), hand_clock)

    def wait():
        hand_clock.now += 2.0

    said = messages(receiver, sender, [(CLEAR, wait), (OBSTACLE, wait), (DARK, wait)])
    lines = [(one.severity, one.text) for one in said if one.get_type() == "STATUSTEXT"]
    assert lines == [
        (INFO, "tokt: clear"),
        (WARNING, "tokt: obstacle ahead"),
        (WARNING, "tokt: unknown, dark"),
        (WARNING, ENDED),
    ]
    assert {one.get_srcComponent() for one in said} == {196}


def test_words_can_be_another_component_s(receiver, hand_clock):
    sender = sender_over(UdpLink(*receiver.getsockname()), hand_clock, words_component=1)
    said = messages(receiver, sender, [(CLEAR, lambda: None)])
    of_one = {one.get_type() for one in said if one.get_srcComponent() == 1}
    assert of_one == {"STATUSTEXT", "NAMED_VALUE_FLOAT"}
    assert "HEARTBEAT" in {one.get_type() for one in said if one.get_srcComponent() == 196}


def test_figures_come_at_five_a_second_and_never_outlive_their_verdict(receiver, hand_clock):
    sender = sender_over(UdpLink(*receiver.getsockname()), hand_clock)

    def wait():
        hand_clock.now += 0.0625

    near = seen(AHEAD, "disparity", 4.5)
    said = messages(receiver, sender, [*[(near, wait)] * 15, (DARK, wait)])
    found = figures(said)
    assert len(found) == 3 * (4 + 1)
    assert found[:3] == [
        ("tokt_stat", 1.0),
        ("tokt_mean", pytest.approx(near.mean)),
        ("tokt_dist", 4.5),
    ]
    assert found[-3:] == [("tokt_stat", -1.0), ("tokt_mean", -1.0), ("tokt_dist", -1.0)]
