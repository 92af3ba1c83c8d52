from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.inference.live import Sent
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import ReportPublisher, mark_stale
from tokt.inference.reason import Fault, Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, unknown_verdict, verdict_from_mask

EMPTY = verdict_from_mask(np.zeros((10, 10), np.uint8), "texture")
FULL = verdict_from_mask(np.full((10, 10), 255, np.uint8), "texture")
BLIND = unknown_verdict(Fault(Reason.DARK, "too dark"))


def a_frame(clock: Any, number: int = 1) -> Frame:
    return Frame(number, clock.time(), None, None, timed=True, arrived=clock.now)


@pytest.fixture
def sent():
    return Sent()


@pytest.fixture
def publisher(sent, hand_clock):
    return ReportPublisher([sent], hand_clock, Limits(), live=True)


def test_a_report_has_frame_time_age_and_latency(publisher, sent, hand_clock):
    frame = a_frame(hand_clock, 7)
    hand_clock.now += 0.1  # it waits
    publisher.begin(frame)
    hand_clock.now += 0.03  # it is judged
    report = publisher.publish(frame, Judgement(EMPTY))
    assert sent.reports == [report] and report.seq == 1 and report.frame == 7
    assert report.t == frame.t
    assert report.age_ms == pytest.approx(130) and report.latency_ms == pytest.approx(30)
    assert (report.verdict.status, report.verdict.reason) == (CLEAR, Reason.OK)


def test_a_restart_says_unknown_at_once(sent, hand_clock):
    publisher = ReportPublisher([sent], hand_clock, Limits(), live=True, first_at_once=True)
    for _ in range(2):
        publisher.heartbeat()
    (report,) = sent.reports
    assert (report.seq, report.verdict.status) == (1, UNKNOWN)


def test_silence_is_broken_by_unknown_with_the_reason(publisher, sent, hand_clock):
    hand_clock.now += 0.49
    publisher.heartbeat()
    assert not sent.reports
    hand_clock.now += 0.02
    publisher.heartbeat()
    publisher.heartbeat()
    assert [report.verdict.reason for report in sent.reports] == [Reason.NO_FRAME]
    assert sent.reports[0].t is None and sent.reports[0].frame is None
    frame = a_frame(hand_clock, 3)
    publisher.begin(frame)
    hand_clock.now += 0.6
    publisher.heartbeat()
    publisher.publish(frame, Judgement(FULL))
    hand_clock.now += 0.6
    publisher.heartbeat()
    reasons = [report.verdict.reason for report in sent.reports]
    assert reasons == [Reason.NO_FRAME, Reason.STALLED, Reason.LATE, Reason.STALE]
    assert [report.seq for report in sent.reports] == [1, 2, 3, 4]
    last = sent.reports[-1]
    assert (last.t, last.frame, last.verdict.status) == (frame.t, None, UNKNOWN)
    assert last.age_ms == pytest.approx(1200)
    assert last.verdict.health == "no frame judged for 0.6 s"
    hand_clock.now += 0.6
    publisher.heartbeat()
    assert sent.reports[-1].verdict.health == "no frame judged for 1.2 s"
    assert publisher.heartbeats() == [sent.reports[index] for index in (0, 1, 3, 4)]
    assert publisher.heartbeats() == []


def test_frames_that_there_was_no_time_for_are_told(publisher, hand_clock):
    frame = a_frame(hand_clock)
    publisher.begin(frame)
    report = publisher.publish(frame, Judgement(EMPTY), left_out=2)
    assert (report.verdict.status, report.verdict.reason) == (CLEAR, Reason.OVERLOAD)
    assert report.verdict.health == "overload: no time for 2 frames before this one"
    publisher.begin(frame)
    blind = publisher.publish(frame, Judgement(BLIND), left_out=1)
    assert blind.verdict.reason is Reason.DARK and "no time for 1 frame" in blind.verdict.health


def test_a_replay_as_fast_as_it_can_has_no_old_frames(sent, hand_clock):
    publisher = ReportPublisher([sent], hand_clock, Limits(), live=False)
    frame = a_frame(hand_clock)
    publisher.begin(frame)
    hand_clock.now += 10
    assert publisher.publish(frame, Judgement(EMPTY)).verdict.status == CLEAR


@given(
    st.sampled_from([EMPTY, FULL, BLIND]), st.floats(0, 100), st.floats(0, 1), st.floats(0.01, 10)
)
def test_age_never_makes_a_clear(verdict, age_s, part, stale_s):
    said = mark_stale(verdict, age_s, part * age_s, stale_s)
    assert said.status != CLEAR or (verdict.status == CLEAR and age_s <= stale_s)
    assert (said.status == OBSTACLE) == (verdict.status == OBSTACLE)
    assert said.status != UNKNOWN or said.reason is not Reason.OK


@pytest.mark.parametrize("verdict", [EMPTY, FULL, BLIND], ids=["clear", "obstacle", "unknown"])
def test_nothing_is_held_in_an_old_frame(verdict):
    held = replace(verdict, anchor_x=0.1, anchor_y=0.2, anchor_size=0.3, anchor="held")
    assert mark_stale(held, 0.4, 0.1, 0.5) == held
    for judging_s in (0.0, 0.6):
        old = mark_stale(held, 0.6, judging_s, 0.5)
        assert (old.anchor_x, old.anchor_y, old.anchor_size) == (None, None, None)
        assert old.anchor == "searching"
    assert mark_stale(replace(held, anchor="lost"), 0.6, 0.0, 0.5).anchor == "lost"
    shared = replace(FULL, anchor_x=0.1)  # of --anchor alone: an obstacle's, which stays
    assert mark_stale(shared, 0.6, 0.0, 0.5).anchor_x == 0.1


def test_the_time_of_day_has_no_say_in_a_frame_s_age(publisher, hand_clock, monkeypatch):
    frame = a_frame(hand_clock)
    monkeypatch.setattr(hand_clock, "time", lambda: 0.0)  # set back by years
    publisher.begin(frame)
    hand_clock.now += 0.02
    report = publisher.publish(frame, Judgement(EMPTY))
    assert report.age_ms == pytest.approx(20) and report.verdict.status == CLEAR
