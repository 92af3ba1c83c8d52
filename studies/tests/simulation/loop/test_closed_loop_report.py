"""What runs came to, on tracks drawn by hand; maps and the page: what is in the data is on them."""

import csv
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tokt_studies.simulation.loop.autopilot import Mode
from tokt_studies.simulation.loop.track import Track
from tokt_studies.simulation.loop.vehicle import State
from tokt_studies.simulation.report.maps import Chart, overview, still
from tokt_studies.simulation.report.outcome import bounds, outcome_of, table
from tokt_studies.simulation.report.report import write_report

RED, BLUE, ORANGE, VIOLET, WATER = "#cc1f2f", "#2f6db3", "#e08a1e", "#8e44ad", "#1f7a8c"


@pytest.fixture(scope="module", autouse=True)
def coarse_figures():
    """None: pixels are looked at."""


def recorded(corners, clearances, frames=None, avoidances=(), reached=True, **about):
    """A track over these corners (east, north), one a second."""
    steps = [
        (float(second), State(np.array([east, 0.0, north]), 0.0, np.zeros(3)), Mode.TRANSIT, away)
        for second, ((east, north), away) in enumerate(zip(corners, clearances, strict=True))
    ]
    scene, method = about.get("scene", "tower"), about.get("method", "m")
    return Track.recorded("a scene", scene, method, 3, steps, frames or (), avoidances, reached)


STRAIGHT = [(0.0, 0.0), (0.0, 4.0), (0.0, 8.0)]
AROUND = [(0.0, 0.0), (3.0, 4.0), (0.0, 8.0)]


def test_clearance_is_from_the_hull_and_below_nothing_it_has_hit():
    near = outcome_of(recorded(STRAIGHT, [5.0, 0.9, 4.0]))
    assert not near.collided and near.clearance_m == pytest.approx(0.1)
    hit = outcome_of(recorded(STRAIGHT, [5.0, 0.79, 4.0]))
    # Whatever else: who hits something has not arrived.
    assert hit.collided and not hit.reached and math.isnan(hit.detour)


def test_the_detour_is_against_the_straight_line():
    assert outcome_of(recorded(STRAIGHT, [9.0] * 3)).detour == pytest.approx(0.0)
    around = outcome_of(recorded(AROUND, [9.0] * 3))
    assert around.path_m == pytest.approx(10.0) and around.detour == pytest.approx(0.25)
    assert math.isnan(outcome_of(recorded(AROUND, [9.0] * 3, reached=False)).detour)


def test_an_avoidance_is_false_where_nothing_solid_was_in_the_picture():
    frames = [(0.0, 0, False), (1.0, 1, True), (2.0, 1, False), (6.0, 1, False), (7.0, -1, False)]
    outcome = outcome_of(recorded(STRAIGHT, [9.0] * 3, frames, avoidances=(2.25, 6.25)))
    assert outcome.avoidances == 2 and outcome.false_avoidances == 1
    assert outcome.false_statuses == 2 and outcome.frames == 5 and outcome.unknown_frames == 1


def test_who_goes_back_with_nothing_in_view_is_counted():
    """Once a time, and not one that holds, or has something solid in view."""
    place = State(np.zeros(3), 0.0, np.zeros(3))
    modes = [Mode.HOLD, Mode.BACK_OFF, Mode.BACK_OFF] * 2 + [Mode.TRANSIT, Mode.BACK_OFF]
    steps = [(5.0 * n + 0.1, place, mode, math.inf) for n, mode in enumerate(modes)]
    frames = [(5.0 * n, -1, n == 4) for n in range(len(modes))]
    runs = [
        outcome_of(Track.recorded("d", "dust", method, 3, steps[:count], frames, (), False))
        for method, count in (("m", 8), ("m", 1))
    ]
    assert [run.false_retreats for run in runs] == [2, 0]
    assert table(runs).loc[0, "went_back"] == 1 and table(runs).loc[0, "false_avoidance"] == 0


def test_bounds_are_clopper_and_pearson_s():
    low, high = bounds(0, 100)
    assert low == 0.0 and high == pytest.approx(1 - 0.025 ** (1 / 100))
    # NIST/SEMATECH e-Handbook, 7.2.4.1: 4 of 20; the value of Clopper and Pearson's tables.
    assert bounds(4, 20) == pytest.approx((0.0573, 0.4366), abs=2e-4)


def test_the_table_has_a_row_for_each_scene_and_method():
    hit = outcome_of(recorded(STRAIGHT, [5.0, 0.5, 4.0], method="none"))
    good = outcome_of(recorded(AROUND, [5.0, 1.8, 4.0]))
    false = outcome_of(recorded(STRAIGHT, [math.inf] * 3, avoidances=(1.0,), scene="snow"))
    rows = table([good, replace(good, clearance_m=2.0), hit, false]).set_index(["scene", "method"])
    assert list(rows.index) == [("tower", "m"), ("tower", "none"), ("snow", "m")]
    assert list(rows["runs"]) == [2, 1, 1] and list(rows["collided"]) == [0, 1, 0]
    assert list(rows["reached"]) == [2, 0, 1] and list(rows["false_avoidance"]) == [0, 0, 1]
    first = rows.loc[("tower", "m")]
    assert first["clearance_min_m"] == pytest.approx(1.0)
    assert first["clearance_median_m"] == pytest.approx(1.5)
    assert first["detour_median"] == pytest.approx(0.25)
    assert first["collided_high"] == pytest.approx(bounds(0, 2)[1])
    assert math.isnan(rows.loc[("tower", "none")]["detour_median"])
    assert math.isnan(rows.loc[("snow", "m")]["clearance_min_m"])


def track(modes, status, least_m, seed=1, method="m"):
    """Straight north past something, a mode for every stretch of a second."""
    count = 20 * len(modes)
    steps = []
    for step in range(count):
        state = State(np.array([0.0, 0.0, step * 0.25]), 0.0, np.zeros(3))
        clearance_m = max(least_m, abs(5 - step * 0.25))
        steps.append((step * 0.05, state, modes[step // 20], clearance_m))
    frames = [(step * 0.05, status, True) for step in range(0, count, 5)]
    return Track.recorded("one <tower>", "tower", method, seed, steps, frames, (), True)


@pytest.fixture(scope="session")
def chart():
    """A square beside the way."""
    outline = np.array([[1.7, 4.2], [1.7, 5.8], [3.3, 5.8], [3.3, 4.2]])
    return Chart([outline], np.array([0.0, 0.0, 16.0]), (0.2, 0.0, 0.0))


def picture(data):
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8)


def pixels(image, color, within=12):
    bgr = [int(color[at : at + 2], 16) for at in (5, 3, 1)]
    return int((np.abs(image.astype(int) - bgr).max(axis=2) <= within).sum())


def test_the_map_shows_modes_verdicts_current_and_the_nearest_place(chart):
    three = [Mode.TRANSIT, Mode.AVOID, Mode.BACK_OFF]
    seen = picture(still(track(three, 1, 1.5), chart))
    for color in (BLUE, ORANGE, VIOLET, WATER):
        assert pixels(seen, color) > 80, color
    assert pixels(seen, RED) > 150, "crosses"
    still_water = replace(chart, current_m_s=(0.0, 0.0, 0.0))
    plain = picture(still(track([Mode.TRANSIT] * 3, 0, 1.5), still_water))
    assert pixels(plain, BLUE) > 80
    for color in (ORANGE, VIOLET, WATER, RED):
        assert pixels(plain, color) == 0, color
    hit = picture(still(track([Mode.TRANSIT] * 3, 0, 0.4), still_water))
    assert pixels(hit, RED) > 80, "the hull where it hit"


def test_the_overview_has_every_run_and_marks_those_that_hit(chart):
    good = track([Mode.TRANSIT] * 3, 0, 1.5)
    hit = track([Mode.TRANSIT] * 3, 0, 0.4)
    pink = "#fdecea"
    none, two = (picture(overview(runs, [chart] * 4)) for runs in ([good] * 4, [good, hit] * 2))
    assert pixels(none, pink, 2) < 100 and pixels(two, pink, 2) > 20000
    assert pixels(two, BLUE) > 100


def test_the_page_has_the_table_and_the_worst_run_and_needs_no_other_file(chart, tmp_path):
    about = ((1, 2.0, 4, "texture"), (1, 0.9, 5, "texture"), (0, 0.3, 6, "none"))
    runs = [track([Mode.TRANSIT] * 2, *one) for one in about]
    write_report(tmp_path, runs, [chart] * 3, ["Flown for <this> test."])
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "Flown for &lt;this&gt; test." in page and "one &lt;tower&gt;" in page
    assert "http" not in page and page.count("data:image/") == 5
    assert "0 (0.0 to 84.2 %)" in page and "1 (2.5 to 100.0 %)" in page
    assert "than 10 m had been in the left picture for 2.5 s" in page
    assert "Seed 5: of these runs the one that came nearest" in page
    names = sorted(path.name for path in (tmp_path / "maps").iterdir())
    texture = ["tower-texture-5.png", "tower-texture-5.webp", "tower-texture.png"]
    assert names == ["tower-none-6.png", "tower-none.png", *texture]
    with (tmp_path / "runs.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert [row["collided"] for row in rows] == ["False", "False", "True"]
    assert len(list(csv.DictReader((tmp_path / "table.csv").open()))) == 2
    assert "went back, nothing in view" in page and "<td>-</td>" not in page
