"""What runs came to, on tracks drawn by hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.loop.vehicle import State
from tokt.studies.simulation.report.outcome import bounds, outcome_of, table


def recorded(
    corners: list[tuple[float, float]],
    clearances: list[float],
    frames: list[tuple[float, int, bool]] | None = None,
    avoidances: tuple[float, ...] = (),
    reached: bool = True,
    **about: Any,
) -> Track:
    """A track over these corners (east, north), one a second."""
    steps = [
        (float(second), State(np.array([east, 0.0, north]), 0.0, np.zeros(3)), Mode.TRANSIT, away)
        for second, ((east, north), away) in enumerate(zip(corners, clearances, strict=True))
    ]
    scene, method = about.get("scene", "tower"), about.get("method", "m")
    return Track.of("a scene", scene, method, 3, steps, frames or (), avoidances, reached)


STRAIGHT = [(0.0, 0.0), (0.0, 4.0), (0.0, 8.0)]
AROUND = [(0.0, 0.0), (3.0, 4.0), (0.0, 8.0)]


def test_clearance_is_from_the_hull_and_below_nothing_it_has_hit() -> None:
    near = outcome_of(recorded(STRAIGHT, [5.0, 0.9, 4.0]))
    assert not near.collided and near.clearance_m == pytest.approx(0.1)
    hit = outcome_of(recorded(STRAIGHT, [5.0, 0.79, 4.0]))
    # Whatever else: who hits something has not arrived.
    assert hit.collided and not hit.reached and math.isnan(hit.detour)


def test_the_detour_is_against_the_straight_line() -> None:
    assert outcome_of(recorded(STRAIGHT, [9.0] * 3)).detour == pytest.approx(0.0)
    around = outcome_of(recorded(AROUND, [9.0] * 3))
    assert around.path_m == pytest.approx(10.0) and around.detour == pytest.approx(0.25)
    assert math.isnan(outcome_of(recorded(AROUND, [9.0] * 3, reached=False)).detour)


def test_an_avoidance_is_false_where_nothing_solid_was_in_the_picture() -> None:
    frames = [(0.0, 0, False), (1.0, 1, True), (2.0, 1, False), (6.0, 1, False), (7.0, -1, False)]
    outcome = outcome_of(recorded(STRAIGHT, [9.0] * 3, frames, avoidances=(2.25, 6.25)))
    assert outcome.avoidances == 2 and outcome.false_avoidances == 1
    assert outcome.false_statuses == 2 and outcome.frames == 5 and outcome.unknown_frames == 1


def test_bounds_are_clopper_and_pearson_s() -> None:
    low, high = bounds(0, 100)
    assert low == 0.0 and high == pytest.approx(1 - 0.025 ** (1 / 100))
    # NIST/SEMATECH e-Handbook, 7.2.4.1: 4 of 20; the value of Clopper and Pearson's tables.
    assert bounds(4, 20) == pytest.approx((0.0573, 0.4366), abs=2e-4)
    with pytest.raises(ValueError, match="no runs"):
        bounds(0, 0)


def test_the_table_has_a_row_for_each_scene_and_method() -> None:
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
    with pytest.raises(ValueError, match="no runs"):
        table([])


def test_json_has_no_number_that_json_has_not() -> None:
    outcome = outcome_of(recorded(STRAIGHT, [math.inf] * 3, reached=False))
    shown = json.loads(json.dumps(outcome.to_json(), allow_nan=False))
    assert shown["clearance_m"] is None and shown["detour"] is None and shown["seed"] == 3


def test_a_track_knows_where_frames_were_taken() -> None:
    frames = [(0.5, 1, True), (1.5, 0, True), (1.75, 1, True)]
    track = recorded(STRAIGHT, [3.0, 1.0, 2.0], frames)
    assert track.obstacle_places[:, 2] == pytest.approx([2.0, 7.0])
    assert track.nearest == 1
    with pytest.raises(ValueError, match="without a step"):
        recorded([], [])
