"""The bench of the labelling page: waiting times, labelling effort, and what is written."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from tests.load.effort.effort import WAYS, EffortBench, LabellingEffort
from tests.load.effort.session import Workflow
from tests.load.program import label_server
from tests.load.report import (
    FOLD,
    LEFT,
    RIGHT,
    WORST,
    Timing,
    check_folder,
    machine_words,
    table,
    write_json,
    yes_or_no,
)
from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import Mission, open_mission
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import FILE_NAME
from tokt.labels.taxonomy import Taxonomy
from tokt.studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt.training.datasets.mission_source import labels_of_mission, read_labels

from .chart import label_chart_png
from .mission import copy_frames, label_all, link_frames
from .tab import HEIGHT, WIDTH, Tab, chromium
from .times import FIRST_FRAME, Repeats, acknowledging, first_page, jumps, live_update, stepping

if TYPE_CHECKING:
    from playwright.sync_api import Browser

TIMES, EFFORT = "times", "effort"
LABEL_FILE = "labels.csv"
MAX_PICTURES = 300
"""So many different pictures at most, each linked to over and over."""
_ANNOTATOR = "bench"

Progress = Callable[..., Any]
Say = Callable[[str], None]


@dataclass(frozen=True)
class PageBenchSize:
    """Numbers of frames and repetitions of the page's bench.

    Parameters
    ----------
    frames : int
        Of the long mission.
    rendered, width : int
        Frames of a mission that is rendered for the bench, and their width in pixels.
    repeats : Repeats
    held : int or None
        Held-out frames of a half that are labelled; None for all.
    ways : tuple of Workflow
    halves : int
    """

    frames: int
    rendered: int
    width: int
    repeats: Repeats
    held: int | None
    ways: tuple[Workflow, ...]
    halves: int


FULL = PageBenchSize(10_000, 240, 1360, Repeats(7, 100, 40, 100, 20), None, WAYS, 2)
QUICK = PageBenchSize(300, 60, 360, Repeats(1, 3, 2, 3, 1), 6, WAYS[:1], 1)


@dataclass(frozen=True)
class LabelBench:
    """Results of one run.

    Parameters
    ----------
    times : list of Timing
    efforts : list of LabellingEffort
    about : dict
        Everything else of the JSON object.
    """

    times: list[Timing]
    efforts: list[LabellingEffort]
    about: dict[str, Any]

    @property
    def faithful(self) -> bool:
        """Whether every label came out as it was asked for."""
        return not any(effort.wrong for effort in self.efforts)

    def to_json(self) -> dict[str, Any]:
        """The JSON object of ``python -m tests.load page --json``."""
        return {
            "times": [time.to_json() for time in self.times],
            "effort": [effort.to_json() for effort in self.efforts],
            **self.about,
        }


def measure_page(
    mission: Mission,
    extent: PageBenchSize,
    folder: Path,
    browser: Browser,
    progress: Progress,
    say: Say,
) -> list[Timing]:
    """Make a long mission of links and measure the page on it, empty and fully labelled."""
    say(f"-- a mission of {extent.frames} frames")
    numbers = mission.frames()[:MAX_PICTURES]
    copy_frames(mission, numbers, folder / "pictures")
    long = folder / "long"
    link_frames(folder / "pictures" / "Left", long, extent.frames)
    say("-- the page without labels")
    times = _page_times(long, folder / "empty", extent, browser)
    full = folder / "full"
    count = label_all(full / FILE_NAME, long.name, extent.frames, _ANNOTATOR, progress)
    say(f"-- the page with {count:,} labels")
    of = f"; {count:,} labels in the store"
    return times + _page_times(long, full, extent, browser, "_labelled", of)


def _page_times(
    mission: Path,
    workspace: Path,
    extent: PageBenchSize,
    browser: Browser,
    suffix: str = "",
    of: str = "",
) -> list[Timing]:
    """The times on a mission; where labels make no difference only without, thus no `suffix`."""
    repeats = extent.repeats
    with label_server(mission, workspace, ["--annotator", _ANNOTATOR]) as url:
        times = [first_page(browser, url, repeats, suffix, of)]
        tab = Tab(browser, url)
        tab.open(FIRST_FRAME)
        times += stepping(tab, repeats, suffix, of)
        if not suffix:
            times.append(jumps(tab, extent.frames, repeats))
        times += acknowledging(tab, range(DEFAULT_GRID.n_patches), repeats, suffix, of)
        tab.close()
        if not suffix:
            times.append(live_update(browser, url, Taxonomy.load().names, repeats))
    return times


def _records(mission: Mission, labels: Path | None) -> list[LabelRecord]:
    """The labels to reproduce. Raises ToktError if there are none."""
    file = labels or mission.path / LABEL_FILE
    if not file.is_file():
        raise ToktError(f"no label file {file}: --effort has nothing to reproduce (see --labels)")
    read = read_labels([file], Taxonomy.load(), DEFAULT_GRID)
    return labels_of_mission(mission, read, DEFAULT_GRID, only=True)[0]


def run_label_bench(
    out: Path,
    mission: Path | None,
    labels: Path | None,
    extent: PageBenchSize,
    parts: Collection[str],
    progress: Progress,
    say: Say,
) -> LabelBench:
    """Measure the labelling page and write ``label.json`` and ``label.png`` into `out`.

    Parameters
    ----------
    out : Path
    mission : Path or None
        None for one that is rendered for it and thrown away.
    labels : Path or None
        Its label file; by default ``labels.csv`` in the mission's folder.
    extent : PageBenchSize
    parts : collection of str
        `TIMES`, `EFFORT`: which are measured.
    progress, say : callable

    Raises
    ------
    ToktError
        If the mission or its labels cannot be used, there is no browser to measure with, or the
        page does not answer.
    """
    if labels is not None and mission is None:
        raise ToktError("--labels goes together with --mission")
    check_folder(out)
    times: list[Timing] = []
    efforts: list[LabellingEffort] = []
    halves: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="tokt-bench-") as name, chromium() as browser:
        folder = Path(name)
        if mission is None:
            say("-- render a mission")
            simulate_mission(
                folder / "rendered", n_frames=extent.rendered, width=extent.width, progress=progress
            )
        shown = open_mission(mission or folder / "rendered")
        if EFFORT in parts:
            records = _records(shown, labels)
            bench = EffortBench(shown, records, extent.held, extent.ways, extent.halves)
            efforts, halves = bench.run(browser, progress, say)
        if TIMES in parts:
            times = measure_page(shown, extent, folder, browser, progress, say)
        browser_name = f"Chromium {browser.version}, headless, {WIDTH}x{HEIGHT}"
    about = {
        "machine": machine(),
        "browser": browser_name,
        "playwright": version("playwright"),
        "mission": "rendered" if mission is None else mission.resolve().name,
        "frames": extent.frames if TIMES in parts else None,
        "halves": halves,
    }
    found = LabelBench(times, efforts, about)
    write_json(out / "label.json", found.to_json())
    atomic.write_bytes(out / "label.png", label_chart_png(times, efforts, about))
    return found


def label_report(
    times: Sequence[Timing], efforts: Sequence[LabellingEffort], about: Mapping[str, Any]
) -> list[Table | str]:
    """What was found, to be printed."""
    frames = f", {about['frames']} frames of links to it" if about["frames"] else ""
    return [
        *([_table_of_times(times)] if times else []),
        *([_table_of_efforts(efforts)] if efforts else []),
        *(
            f"effort, half {place}: {half['model']} model of frames {half['trained_on']}, labelled "
            f"{half['held_out']}; suggestions follow {half['keep']:g} (as the page is set)"
            for place, half in enumerate(about["halves"], 1)
        ),
        f"mission: {about['mission']}{frames}; {about['browser']}",
        machine_words(about),
        *(f"{effort.way.name}: {text}" for effort in efforts for text in effort.wrong),
    ]


def _columns(*headings: str) -> dict[str, dict[str, Any]]:
    return {headings[0]: LEFT} | dict.fromkeys(headings[1:], RIGHT) | {"": FOLD}


def _table_of_times(times: Sequence[Timing]) -> Table:
    rows = []
    for time in times:
        of = "worst" if time.percentile == WORST else f"p{time.percentile}"
        rows.append(
            (
                time.name,
                *(f"{time.at(percentile):.1f}" for percentile in (50, 95, WORST)),
                "" if time.asked_ms is None else f"{of} {time.asked_ms:g}",
                yes_or_no(time.holds),
                str(len(time.times_ms)),
                time.what,
            )
        )
    return table(_columns("ms", "p50", "p95", "worst", "asked", "kept", "n"), rows)


def _table_of_efforts(efforts: Sequence[LabellingEffort]) -> Table:
    headings = ("actions", "without", "with", "ratio", "asked", "kept", "labels equal")
    rows = [
        (
            effort.way.name,
            " + ".join(map(str, effort.without)),
            " + ".join(map(str, effort.with_model)),
            f"{effort.ratio:.1f}x",
            "" if effort.way.asked is None else f"{effort.way.asked:g}x",
            yes_or_no(effort.holds),
            yes_or_no(not effort.wrong),
            effort.way.words,
        )
        for effort in efforts
    ]
    return table(_columns(*headings), rows)
