"""Holding an object in the centre: the errors, their signs, and the page's controller."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.inference.policy.temporal_cues import Anchor, AnchorErrors
from tokt.inference.verdict import Verdict, verdict_from_mask

HEIGHT, WIDTH = 271, 360
LABVIEW = (Path(__file__).parents[3] / "docs" / "tutorials" / "labview.md").read_text()


def seen(rows: slice, cols: slice) -> Verdict:
    """The verdict on patches of a grid."""
    patches = np.zeros((10, 10), bool)
    patches[rows, cols] = True
    return verdict_from_mask(DEFAULT_GRID.paint(patches.ravel(), HEIGHT, WIDTH), "texture")


def errors(rows: slice, cols: slice, size: float = 0.1) -> AnchorErrors:
    return Anchor(size).errors(seen(rows, cols))


@pytest.mark.parametrize(
    ("rows", "cols", "held", "x", "y", "share"),
    [
        (slice(7, 9), slice(6, 9), 0.03, 0.5, 0.6, 2),  # right, below and too large: positive
        (slice(1, 3), slice(1, 4), 0.24, -0.5, -0.6, 0.25),
    ],
)
def test_errors_have_signs_against_the_way_to_steer(rows, cols, held, x, y, share):
    found, verdict = errors(rows, cols, held), seen(rows, cols)
    assert found.x == pytest.approx(x, abs=0.01) and found.y == pytest.approx(y, abs=0.02)
    assert found.size == pytest.approx(0.5 * math.log(share), abs=0.01)
    assert verdict.x * x < 0 and verdict.y * y < 0


@pytest.mark.parametrize("size", [0.0, -0.1, 0.009, 0.91, 10.0, math.nan, math.inf])
def test_a_share_that_cannot_be_held_is_refused(size):
    refuses(r"0\.01 to 0\.9", Anchor, size)


sides = st.integers(1, 400)


@given(sides, sides, st.data())
def test_any_mask_has_errors_within_their_bounds(height, width, data):
    mask = np.zeros((height, width), np.uint8)
    y0, x0 = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    y1, x1 = data.draw(st.integers(y0 + 1, height)), data.draw(st.integers(x0 + 1, width))
    mask[y0:y1, x0:x1] = 255
    verdict = verdict_from_mask(mask, "texture")
    found = Anchor(0.1).errors(verdict)
    assert (found.x is None) == (verdict.status == 0)
    if found.x is not None:
        assert -1 <= found.x <= 1 and -1 <= found.y <= 1 and -4 < found.size <= 1.152


# The controller of docs/tutorials/labview.md, before a disc in front of a camera


def commands_of_the_page() -> Callable[[dict[str, Any]], tuple[float, float, float]]:
    (program,) = re.findall(r"^```python\n(def commands.*?)^```", LABVIEW, re.M | re.S)
    found: dict[str, Any] = {}
    exec(program, found)
    return found["commands"]


def look(at: np.ndarray) -> Verdict:
    """What a grid of patches sees of a disc of 0.5 m radius, `at` metres right, down and ahead."""
    rows, cols = np.mgrid[0:HEIGHT, 0:WIDTH]
    focal_px = 600.0
    x = (cols - WIDTH / 2) / focal_px * at[2] - at[0]
    y = (rows - HEIGHT / 2) / focal_px * at[2] - at[1]
    covered = (x**2 + y**2 < 0.25)[:270].reshape(10, 27, 10, 36).mean((1, 3)) > 0.3
    return verdict_from_mask(DEFAULT_GRID.paint(covered.ravel(), HEIGHT, WIDTH), "texture")


def held(commands, start, size) -> np.ndarray:
    """Where the disc is after 60 s in which the commands are obeyed."""
    at, anchor, step_s = np.array(start), Anchor(size), 0.25
    for _ in range(240):
        verdict = look(at)
        x, y, error = anchor.errors(verdict)
        told = {"reason": "ok", "anchor_x": x, "anchor_y": y, "anchor_size": error}
        surge, sway, heave = commands(told)
        at = at - np.array([sway, heave, surge]) * step_s
    return at


@pytest.mark.parametrize("start", [(0.6, 0.2, 4.0), (-0.4, -0.2, 2.0), (0.0, 0.3, 7.0)])
def test_the_page_s_controller_holds_the_object(start):
    x, y, z = held(commands_of_the_page(), start, 0.1)
    wanted_m = math.sqrt(math.pi * 0.25 / (0.1 * HEIGHT * WIDTH)) * 600
    assert abs(x) < 0.12 and abs(y) < 0.12 and z == pytest.approx(wanted_m, rel=0.15)


def test_the_page_s_pid_blocks_act_the_same_way():
    """A PID block's output is its gain times setpoint (0) less process variable."""
    axes = dict(map(reversed, re.findall(r"`(-?anchor_\w+)` for (\w+)", LABVIEW)))
    told = {"reason": "ok", "anchor_x": 0.11, "anchor_y": -0.23, "anchor_size": 0.37}
    named = [axes[axis] for axis in ("surge", "sway", "heave")]
    variables = [told[name.lstrip("-")] * (-1 if name[0] == "-" else 1) for name in named]
    outputs = [0.3 * (0 - variable) for variable in variables]
    assert outputs == pytest.approx(commands_of_the_page()(told))


def test_nothing_seen_commands_nothing():
    told = {"reason": "ok", "anchor_x": None, "anchor_y": None, "anchor_size": None}
    old = dict.fromkeys(told, 0.2)
    for said in (told, {**old, "reason": "stale"}, {**old, "reason": "late"}):
        assert commands_of_the_page()(said) == (0.0, 0.0, 0.0)
