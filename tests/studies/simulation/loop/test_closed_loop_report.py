"""Maps and the page: what is in the data is on them."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.studies.simulation.loop.autopilot import Mode
from tokt.studies.simulation.loop.track import Track
from tokt.studies.simulation.loop.vehicle import State
from tokt.studies.simulation.report.maps import Chart, animation, overview, still
from tokt.studies.simulation.report.report import write_report

pytestmark = pytest.mark.xdist_group("closed_loop_stand_in")

RED, BLUE, ORANGE, VIOLET, WATER = "#cc1f2f", "#2f6db3", "#e08a1e", "#8e44ad", "#1f7a8c"


def track(
    modes: list[Mode], status: int, least_m: float, seed: int = 1, method: str = "m"
) -> Track:
    """Straight north past something, a mode for every stretch of a second."""
    count = 20 * len(modes)
    steps = [
        (
            step * 0.05,
            State(np.array([0.0, 0.0, step * 0.25]), 0.0, np.zeros(3)),
            modes[step // 20],
            max(least_m, abs(5 - step * 0.25)),
        )
        for step in range(count)
    ]
    frames = [(step * 0.05, status, True) for step in range(0, count, 5)]
    return Track.of("one <tower>", "tower", method, seed, steps, frames, (), True)


@pytest.fixture(scope="session")
def chart(stand_in: SimpleNamespace) -> Chart:
    return Chart([stand_in.tower(2.5, 5.0)], np.array([0.0, 0.0, 16.0]), (0.2, 0.0, 0.0))


def picture(data: bytes) -> NDArray[np.uint8]:
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8)


def pixels(image: NDArray[np.uint8], color: str, within: int = 12) -> int:
    bgr = [int(color[at : at + 2], 16) for at in (5, 3, 1)]
    return int((np.abs(image.astype(int) - bgr).max(axis=2) <= within).sum())


def test_the_map_shows_modes_verdicts_current_and_the_nearest_place(chart: Chart) -> None:
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


def test_the_animation_moves_and_its_track_grows(chart: Chart, tmp_path: Path) -> None:
    file = tmp_path / "run.webp"
    file.write_bytes(animation(track([Mode.TRANSIT] * 3, 1, 1.5), chart))
    done, film = cv2.imreadanimation(str(file))
    assert done and len(film.frames) >= 3
    # WebP's colours are about right.
    blue = [pixels(frame[:, :, :3], BLUE, 60) for frame in film.frames]
    red = [pixels(frame[:, :, :3], RED, 60) for frame in film.frames]
    assert blue[0] < blue[1] < blue[-1]
    assert red[0] < red[1] < red[-1]


def test_the_overview_has_every_run_and_marks_those_that_hit(chart: Chart) -> None:
    good = track([Mode.TRANSIT] * 3, 0, 1.5)
    hit = track([Mode.TRANSIT] * 3, 0, 0.4)
    pink = "#fdecea"
    none, two = (picture(overview(runs, [chart] * 4)) for runs in ([good] * 4, [good, hit] * 2))
    assert pixels(none, pink, 2) < 100 and pixels(two, pink, 2) > 20000
    assert pixels(two, BLUE) > 100
    with pytest.raises(ValueError, match="1 tracks and 2 charts"):
        overview([good], [chart] * 2)


def test_the_page_has_the_table_and_the_worst_run_and_needs_no_other_file(
    chart: Chart, tmp_path: Path
) -> None:
    runs = [
        track([Mode.TRANSIT] * 2, status, least, seed, method)
        for status, least, seed, method in (
            (1, 2.0, 4, "texture"), (1, 0.9, 5, "texture"), (0, 0.3, 6, "none")
        )
    ]  # fmt: skip
    write_report(tmp_path, runs, [chart] * 3, ["Flown for <this> test."])
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "Flown for &lt;this&gt; test." in page and "one &lt;tower&gt;" in page
    assert "http" not in page and page.count("data:image/") == 5
    assert "0 (0.0 to 84.2 %)" in page and "1 (2.5 to 100.0 %)" in page
    assert "than 10 m had been in the left picture for 2.5 s" in page
    assert "Seed 5: of these runs the one that came nearest" in page
    names = sorted(path.name for path in (tmp_path / "maps").iterdir())
    assert names == [
        "tower-none-6.png",
        "tower-none.png",
        "tower-texture-5.png",
        "tower-texture-5.webp",
        "tower-texture.png",
    ]
    with (tmp_path / "runs.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert [row["collided"] for row in rows] == ["False", "False", "True"]
    assert len(list(csv.DictReader((tmp_path / "table.csv").open()))) == 2
