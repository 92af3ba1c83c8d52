"""The bench of the labelling page: waiting times, labelling effort, and what is written."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...features import atomic
from ...features.errors import ToktError
from ...features.grid import DEFAULT_GRID
from ...features.machine import machine
from ...features.mission import Mission, open_mission
from ...labels.record import LabelRecord
from ...labels.store import FILE_NAME
from ...labels.synthetic.mission import simulate_mission
from ...labels.taxonomy import Taxonomy
from ..mission_source import labels_of_mission, read_labels
from .browser import chromium
from .effort_person import Effort, Way
from .label_chart import label_chart_png
from .label_effort import WAYS, EffortBench
from .label_mission import copy_frames, label_all, link_frames
from .label_server import label_server
from .label_tab import HEIGHT, WIDTH, Tab
from .page_times import (
    FIRST_FRAME,
    Repeats,
    acknowledging,
    first_page,
    jumps,
    live_update,
    stepping,
)
from .timing import Timing

if TYPE_CHECKING:
    from playwright.sync_api import Browser

LABEL_FILE = "labels.csv"
MOST_PICTURES = 300
"""So many different pictures at most, each linked to over and over."""
_ANNOTATOR = "bench"

Progress = Callable[..., Any]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Extent:
    """How much is measured.

    Parameters
    ----------
    frames : int
        Of the long mission.
    rendered, width : int
        Frames of a mission that is rendered for the bench, and their width in pixels.
    repeats : Repeats
    held : int or None
        Held-out frames of a half that are labelled; None for all.
    ways : tuple of Way
    halves : int
    """

    frames: int
    rendered: int
    width: int
    repeats: Repeats
    held: int | None
    ways: tuple[Way, ...]
    halves: int


FULL = Extent(10_000, 240, 1360, Repeats(7, 100, 40, 100, 20), None, WAYS, 2)
QUICK = Extent(300, 60, 360, Repeats(1, 3, 2, 3, 1), 6, WAYS[:1], 1)


@dataclass(frozen=True)
class LabelBench:
    """What one run found.

    Parameters
    ----------
    times : list of Timing
    efforts : list of Effort
    about : dict
        Everything else of the JSON object.
    """

    times: list[Timing]
    efforts: list[Effort]
    about: dict[str, Any]

    @property
    def faithful(self) -> bool:
        """Whether every label came out as it was asked for."""
        return not any(effort.wrong for effort in self.efforts)

    def to_json(self) -> dict[str, Any]:
        """The JSON object of ``tokt bench --label --json``."""
        return {
            "times": [time.to_json() for time in self.times],
            "effort": [effort.to_json() for effort in self.efforts],
            **self.about,
        }


def measure_page(
    mission: Mission, extent: Extent, folder: Path, browser: Browser, progress: Progress, say: Say
) -> list[Timing]:
    """Make a long mission of links and measure the page on it, empty and fully labelled."""
    say(f"-- a mission of {extent.frames} frames")
    numbers = mission.frames()[:MOST_PICTURES]
    copy_frames(mission, numbers, folder / "pictures")
    long = folder / "long"
    link_frames(folder / "pictures" / "Left", long, extent.frames)
    say("-- the page without labels")
    times = _without_labels(long, folder / "empty", extent, browser)
    full = folder / "full"
    count = label_all(full / FILE_NAME, long.name, extent.frames, _ANNOTATOR, progress)
    say(f"-- the page with {count:,} labels")
    return times + _with_labels(long, full, f"; {count:,} labels in the store", extent, browser)


def _without_labels(
    mission: Path, workspace: Path, extent: Extent, browser: Browser
) -> list[Timing]:
    repeats = extent.repeats
    names = Taxonomy.load().names
    with label_server(mission, workspace, ["--annotator", _ANNOTATOR]) as url:
        times = [first_page(browser, url, repeats, "", "")]
        tab = Tab(browser, url)
        tab.open(FIRST_FRAME)
        times += stepping(tab, repeats, "", "")
        times.append(jumps(tab, extent.frames, repeats))
        times += acknowledging(tab, range(DEFAULT_GRID.n_patches), repeats, "", "")
        tab.close()
        times.append(live_update(browser, url, names, repeats))
    return times


def _with_labels(
    mission: Path, workspace: Path, of: str, extent: Extent, browser: Browser
) -> list[Timing]:
    repeats, suffix = extent.repeats, "_labelled"
    with label_server(mission, workspace, ["--annotator", _ANNOTATOR]) as url:
        times = [first_page(browser, url, repeats, suffix, of)]
        tab = Tab(browser, url)
        tab.open(FIRST_FRAME)
        times += stepping(tab, repeats, suffix, of)
        times += acknowledging(tab, range(DEFAULT_GRID.n_patches), repeats, suffix, of)
        tab.close()
    return times


def _records(mission: Mission, labels: Path | None) -> list[LabelRecord]:
    """The labels to reproduce. Raises ToktError if there are none."""
    file = labels or mission.path / LABEL_FILE
    if not file.is_file():
        raise ToktError(f"no label file {file}: --effort has nothing to reproduce (see --labels)")
    read = read_labels([file], Taxonomy.load(), DEFAULT_GRID)
    return labels_of_mission(mission, read, DEFAULT_GRID, only=True)[0]


@dataclass(frozen=True)
class LabelRequest:
    """What to measure, and on what.

    Parameters
    ----------
    mission : Path or None
        None for one that is rendered for it and thrown away.
    labels : Path or None
        Its label file; by default ``labels.csv`` in the mission's folder.
    extent : Extent
    times, effort : bool
        Which of the two parts.
    """

    mission: Path | None
    labels: Path | None
    extent: Extent
    times: bool
    effort: bool


def run_label_bench(out: Path, request: LabelRequest, progress: Progress, say: Say) -> LabelBench:
    """Measure the labelling page and write ``label.json`` and ``label.png`` into `out`.

    Raises
    ------
    ToktError
        If the mission or its labels cannot be used, there is no browser to measure with, or the
        page does not answer.
    """
    if request.labels is not None and request.mission is None:
        raise ToktError("--labels goes together with --mission")
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with --out")
    with tempfile.TemporaryDirectory(prefix="tokt-bench-") as name, chromium() as browser:
        found = _measure(request, Path(name), browser, progress, say)
    text = json.dumps(found.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "label.json", text + "\n")
    atomic.write_bytes(out / "label.png", label_chart_png(found.times, found.efforts, found.about))
    return found


def _measure(
    request: LabelRequest, folder: Path, browser: Browser, progress: Progress, say: Say
) -> LabelBench:
    extent, path, shown_as = request.extent, request.mission, "rendered"
    if path is None:
        say("-- render a mission")
        path = folder / "rendered"
        simulate_mission(path, n_frames=extent.rendered, width=extent.width, progress=progress)
    else:
        shown_as = path.resolve().name
    mission = open_mission(path)
    times: list[Timing] = []
    efforts: list[Effort] = []
    halves: list[dict[str, Any]] = []
    if request.effort:
        records = _records(mission, request.labels)
        bench = EffortBench(mission, records, extent.held, extent.ways, extent.halves)
        efforts, halves = bench.run(browser, progress, say)
    if request.times:
        times = measure_page(mission, extent, folder, browser, progress, say)
    about = {
        "machine": machine(),
        "browser": f"Chromium {browser.version}, headless, {WIDTH}x{HEIGHT}",
        "playwright": version("playwright"),
        "mission": shown_as,
        "frames": extent.frames if request.times else None,
        "halves": halves,
    }
    return LabelBench(times, efforts, about)
