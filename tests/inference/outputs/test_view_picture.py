"""The live view's picture: each state in words and shapes, the minute's strip, any frame."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.conftest import NoiseScorer, draw
from tests.tiers import scaled
from tokt.inference.frame import Frame
from tokt.inference.outputs.view_picture import (
    BANNER,
    ENDED,
    OLD,
    PANEL,
    STRIP,
    STRIP_S,
    WAITING,
    WIDTH,
    ViewMoment,
    ViewState,
    fitted,
)
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Report
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, Verdict, unknown_verdict

AT = 100.0
DARK = unknown_verdict(Fault(Reason.DARK, "too dark"))


def moment(patches=(), left=None, said_s=AT, statuses=None, verdict=None, age_s=0.0):
    left = draw(list(patches)) if left is None else left
    judged = SinglePolicy(TextureDetector(NoiseScorer())).judge(Frame(1, 1.0, left, None))
    verdict = verdict or judged.verdict
    report = Report(1, 1, 1.0, 5.0, verdict, 1000 * age_s)
    statuses = ((said_s, verdict.status),) if statuses is None else statuses
    seen = (
        (None, None, None)
        if verdict.status == UNKNOWN
        else (fitted(left), judged.mask, judged.grid)
    )
    return ViewMoment(report, said_s, said_s - age_s, statuses, *seen)


def drawn(*moments, at=AT, ended=""):
    state = ViewState(0.5, ended)
    for each in moments:
        state.take(each)
    shown = state.shown(at)
    return shown, state.draw(shown, at)


def test_the_part_that_is_not_seen_has_a_box():
    def with_blind(box, status):
        sight = {"seen": (0.6,), "blind": box}
        verdict = DARK if status == UNKNOWN else moment().report.verdict
        return drawn(moment(verdict=replace(verdict, sight=sight)))[1][BANNER : -PANEL - STRIP]

    for status in (CLEAR, UNKNOWN):
        without = with_blind((0.5, 0.0, 0.1, 0.1), status)
        shown = with_blind((0.5, 0.0, 0.5, 0.3), status)
        changed = np.argwhere((shown != without).any(axis=2))
        assert changed[:, 1].min() >= 0.49 * WIDTH and changed[:, 0].max() < 0.35 * len(shown)


def strip_of(picture):
    return picture[-STRIP:]


def heights(picture):
    """How many pixels of each column of the strip are not its ground."""
    return (strip_of(picture).astype(int).max(axis=2) > 31).sum(axis=0)


def test_the_named_object_has_a_box_of_its_own_and_a_word():
    plain = moment()
    verdict = replace(plain.report.verdict, anchor="held")
    held = replace(
        plain, report=replace(plain.report, verdict=verdict), held=(0.25, 0.5, 0.5, 0.25)
    )
    (before, bare), (shown, picture) = drawn(plain), drawn(held)
    assert "object" not in before.facts and shown.facts["object"] == "held" and shown.frame == 1
    top, bottom = shown.rows
    assert (top, bottom) == (BANNER, BANNER + 542)
    differs = np.abs(picture[top:bottom].astype(int) - bare[top:bottom]).max(axis=2) > 40
    rows, cols = np.nonzero(differs[271:])
    assert abs(rows.max() + 271 - 0.75 * 542) < 6 and abs(cols.min() - 180) < 6
    assert abs(cols.max() - 540) < 6
    refused = drawn(replace(held, refused="too small"))[0]
    assert refused.facts["object"] == "held: too small"
    for old in (drawn(held, at=AT + 1), drawn(held, ended="over")):
        assert "object" not in old[0].facts


def test_each_state_has_its_words():
    obstacle = moment([(4, 2)])
    for word, why, moments, more in (
        (WAITING, "no frame yet", (), {}),
        ("OBSTACLE", "", (obstacle,), {}),
        ("CLEAR", "", (moment(),), {}),
        ("UNKNOWN", "dark: too dark", (moment(verdict=DARK),), {}),
        ("UNKNOWN", "dark: too dark", (moment(verdict=DARK),), {"at": AT + 9}),
        (OLD, "nothing newer for 1.5 s", (moment(),), {"at": AT + 1.5}),
        (OLD, "nothing newer for 0.8 s", (moment(age_s=0.8),), {}),
        (OLD, "an obstacle was seen; nothing newer for 2.0 s", (obstacle,), {"at": AT + 2}),
        (ENDED, "the run is over", (obstacle,), {"ended": "the run is over"}),
        (ENDED, "the run died", (), {"ended": "the run died"}),
    ):
        shown, picture = drawn(*moments, **more)
        assert (shown.word, shown.why) == (word, why)
        assert picture.dtype == np.uint8 and not any(size % 2 for size in picture.shape[:2])
        assert shown.age_s == pytest.approx(more.get("at", AT) - AT, abs=1)


def test_only_what_a_frame_was_judged_for_has_an_age():
    """A second that stands still, or counts up while none came, looks alive."""
    for more, aged in (({}, True), ({"ended": "the run is over"}, False)):
        picture = drawn(moment(), **more)[1]
        assert (picture[5 : BANNER - 5, 590:680].min(axis=2) > 200).any() == aged


def test_where_to_is_said_only_of_now():
    far = Verdict(1, -7, 9, (0, 0, 9, 9), 9.0, 2.34, "disparity", None, mask_size=(271, 360))
    facts = {"distance": "2.3 m", "steer": "left 7 px, down 9 px"}
    always = {"model": "disparity", "health": "ok"}
    assert drawn(moment(verdict=far))[0].facts == {**facts, **always}
    assert drawn(moment(verdict=far), at=AT + 3)[0].facts == always
    assert drawn(moment(verdict=far), ended="the run is over")[0].facts == always


def test_no_state_is_told_by_its_colour_alone():
    """In gray, by what is bright of it: the signs at the left differ."""
    made = {
        "obstacle": drawn(moment([(4, 2)])),
        "clear": drawn(moment()),
        "unknown": drawn(moment(verdict=DARK)),
        "old": drawn(moment(), at=AT + 2),
    }
    shapes = {}
    for name, (_, picture) in made.items():
        icon = picture[:BANNER, :BANNER].mean(axis=2)
        shapes[name] = icon > (icon.min() + icon.max()) / 2
    for one, other in (("obstacle", "clear"), ("obstacle", "unknown"), ("clear", "old")):
        assert (shapes[one] != shapes[other]).mean() > 0.1


def test_what_is_no_verdict_of_now_darkens_the_picture_and_covers_its_width():
    clear = drawn(moment())[1]
    for _, picture in (
        drawn(moment(), moment(verdict=DARK)),
        drawn(moment(), at=AT + 2),
        drawn(moment(), ended="the run is over"),
    ):
        frame, whole = picture[BANNER : -PANEL - STRIP], clear[BANNER : -PANEL - STRIP]
        assert frame[:40].mean() < 0.5 * whole[:40].mean()
        middle = len(frame) // 2
        assert (frame[middle - 79 : middle - 71] == 0).all()  # from edge to edge
        striped = frame[middle - 85] > 0
        assert striped[:20].any() and striped[-40:].any()


def test_the_obstacle_s_cells_are_hatched_and_the_arrow_points_away():
    clear = drawn(moment())[1].astype(int)
    found = drawn(moment([(4, 2)], statuses=()))[1].astype(int)
    yellow = (np.abs(found - [0, 200, 255]).max(axis=2) < 30)[BANNER : -PANEL - STRIP]
    rows, columns = np.nonzero(yellow)
    unit = WIDTH / 360
    assert rows.min() >= 4 * 27 * unit - 4 and rows.max() <= 5 * 27 * unit + 4
    assert columns.min() >= 2 * 36 * unit - 4 and columns.max() <= 3 * 36 * unit + 4
    cell = yellow[round(4 * 27 * unit) : round(5 * 27 * unit), round(72 * unit) : round(108 * unit)]
    assert 0.1 < cell.mean() < 0.5
    white = (found.min(axis=2) > 250)[BANNER : -PANEL - STRIP]
    right, left = white[:, 370:].sum(), white[:, 220:350].sum()
    assert right > 500 > left  # it is left of the middle: steer right
    lines = clear[BANNER : -PANEL - STRIP].mean(axis=2)
    grid = lines[:, [round(36 * n * unit) for n in range(1, 10)]].mean()
    assert grid > lines.mean() + 20


def test_the_strip_has_the_last_minute_s_worst_status_at_each_place():
    said = [(AT - 59.9 + 0.1 * n, CLEAR) for n in range(600)]
    said[300:400] = [(t, UNKNOWN) for t, _ in said[300:400]]
    said[100] = (said[100][0], OBSTACLE)  # one frame
    del said[450:500]
    high = heights(drawn(moment(statuses=tuple(said)))[1])
    per_s = WIDTH / STRIP_S
    at = {name: high[round(s * per_s)] for name, s in (("obstacle", 10.1), ("unknown", 35.0))}
    assert high.max() == STRIP and (high == STRIP).sum() <= 2
    assert at["unknown"] == high[round(5 * per_s)] == 6  # but not at the same place
    unknown, clear = (
        strip_of(drawn(moment(statuses=tuple(said)))[1])[:, round(s * per_s)] for s in (35, 5)
    )
    assert unknown[9].max() > 200 and clear[9].max() < 40 and clear[16].max() > 100
    assert STRIP in high[round(10 * per_s) - 2 : round(10 * per_s) + 3]
    # Of 5 s nothing was said: held for half a second, then nothing.
    assert (
        high[round(45.2 * per_s)] == 6 and not high[round(45.7 * per_s) : round(49.8 * per_s)].any()
    )
    assert heights(drawn(moment(statuses=()))[1]).max() == 0


def test_the_strip_moves_on_and_forgets():
    state = ViewState(0.5)
    state.take(moment([(4, 2)]))
    places = []
    for later in (0, 20, 40, 59):
        (columns,) = np.nonzero(heights(state.draw(state.shown(AT + later), AT + later)) == STRIP)
        places.append(columns.mean())
    assert places == sorted(places, reverse=True) and places[-1] < 16
    state.take(moment(said_s=AT + 90))
    assert state.statuses == [(AT + 90, CLEAR)]


@settings(max_examples=scaled(40))
@given(
    st.tuples(st.integers(1, 700), st.integers(1, 2000), st.sampled_from([(), (3,)])),
    st.sampled_from([OBSTACLE, CLEAR, UNKNOWN]),
    st.text(max_size=400),
)
def test_any_frame_and_any_words_are_drawn(shape, status, words):
    high, wide, channels = shape
    left = np.full((high, wide, *channels), 90, np.uint8)
    verdict = Verdict(
        *(status, 5000, -3, (0, 0, 9, 9), 3.0, 1e9, "none", words), words, mask_size=(271, 360)
    )
    report = Report(1, 1, 1.0, 5.0, verdict)
    found = ViewMoment(
        report, AT, AT, ((AT, status),), fitted(left), np.zeros((271, 360), np.uint8)
    )
    shown, picture = drawn(found)
    assert picture.shape[1] == WIDTH and picture.shape[0] < 2300
    assert picture.shape[2] == 3 and not picture.shape[0] % 2 and not picture.shape[1] % 2
    assert shown.facts["health"] == words


def test_the_whole_reason_and_the_models_name_stand_in_the_picture():
    words = "frames are 200x150, which the model did not learn. It judges others from 240 pixels"
    fault = Fault(Reason.WRONG_SIZE, f"{words} of width on, 0.5 to 2.7 times as wide as high")
    unknown = replace(moment(verdict=unknown_verdict(fault)), model="gate/2")
    shown, picture = drawn(moment(), unknown)
    assert shown.why == f"wrong_size: {fault}"
    assert next(iter(shown.facts.items())) == ("model", "gate/2")
    # Each line of it is as dark at its right edge as beyond its last letter: nothing is cut.
    short, other = drawn(moment(), moment(verdict=DARK))
    changed = np.argwhere((picture != other).any(axis=2))
    band = changed[(changed[:, 0] > BANNER) & (changed[:, 0] < len(picture) - PANEL - STRIP)]
    assert len(shown.why) > len(short.why) and band[:, 1].max() < WIDTH - 6
