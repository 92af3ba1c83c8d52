"""The bench of the labelling page: waiting times, labelling effort, and what is written."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table

from tests.load.effort.effort import WAYS, EffortBench, LabellingEffort
from tests.load.effort.session import Workflow
from tests.load.program import label_server
from tests.load.timing import WORST, Timing
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

from .browser import chromium
from .chart import label_chart_png
from .mission import copy_frames, label_all, link_frames
from .tab import HEIGHT, WIDTH, Tab
from .times import FIRST_FRAME, Repeats, acknowledging, first_page, jumps, live_update, stepping

if TYPE_CHECKING:
    from playwright.sync_api import Browser

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
    times = _without_labels(long, folder / "empty", extent, browser)
    full = folder / "full"
    count = label_all(full / FILE_NAME, long.name, extent.frames, _ANNOTATOR, progress)
    say(f"-- the page with {count:,} labels")
    return times + _with_labels(long, full, f"; {count:,} labels in the store", extent, browser)


def _without_labels(
    mission: Path, workspace: Path, extent: PageBenchSize, browser: Browser
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
    mission: Path, workspace: Path, of: str, extent: PageBenchSize, browser: Browser
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
    """The measurements to make, and the mission for them.

    Parameters
    ----------
    mission : Path or None
        None for one that is rendered for it and thrown away.
    labels : Path or None
        Its label file; by default ``labels.csv`` in the mission's folder.
    extent : PageBenchSize
    times, effort : bool
        Which of the two parts.
    """

    mission: Path | None
    labels: Path | None
    extent: PageBenchSize
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
    efforts: list[LabellingEffort] = []
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


_PLAIN_WIDTH = 170


def verdict(holds: bool | None) -> str:
    """Whether what was asked is kept, in a word."""
    return {True: "yes", False: "NO", None: ""}[holds]


def print_label_tables(
    times: Sequence[Timing], efforts: Sequence[LabellingEffort], about: Mapping[str, Any]
) -> None:
    """Print what was found on standard output, as wide as the terminal or as plain text."""
    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    if times:
        console.print(_table_of_times(times))
    if efforts:
        console.print(_table_of_efforts(efforts))
    for line in _about_lines(about):
        console.print(line, markup=False)
    for effort in efforts:
        for text in effort.wrong:
            console.print(f"{effort.way.name}: {text}", markup=False)


def _table(headings: Sequence[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(headings[0], no_wrap=True)
    for heading in headings[1:]:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    return table


def _table_of_times(times: Sequence[Timing]) -> Table:
    table = _table(("ms", "p50", "p95", "worst", "asked", "kept", "n"))
    for time in times:
        of = "worst" if time.percentile == WORST else f"p{time.percentile}"
        table.add_row(
            time.name,
            *(f"{time.at(percentile):.1f}" for percentile in (50, 95, WORST)),
            "" if time.asked_ms is None else f"{of} {time.asked_ms:g}",
            verdict(time.holds),
            str(len(time.times_ms)),
            time.what,
        )
    return table


def _table_of_efforts(efforts: Sequence[LabellingEffort]) -> Table:
    table = _table(("actions", "without", "with", "ratio", "asked", "kept", "labels equal"))
    for effort in efforts:
        table.add_row(
            effort.way.name,
            " + ".join(map(str, effort.without)),
            " + ".join(map(str, effort.with_model)),
            f"{effort.ratio:.1f}x",
            "" if effort.way.asked is None else f"{effort.way.asked:g}x",
            verdict(effort.holds),
            verdict(not effort.wrong),
            effort.way.words,
        )
    return table


def _about_lines(about: Mapping[str, Any]) -> list[str]:
    """What was measured on what, in sentences."""
    lines = [
        f"effort, half {place}: {half['model']} model of frames {half['trained_on']}, "
        f"labelled {half['held_out']}; suggestions follow {half['keep']:g} (as the page is set)"
        for place, half in enumerate(about["halves"], 1)
    ]
    frames = f", {about['frames']} frames of links to it" if about["frames"] else ""
    computer = about["machine"]
    lines.append(f"mission: {about['mission']}{frames}; {about['browser']}")
    lines.append(
        f"machine: {computer['cpu']}, {computer['cores']} core(s); python {computer['python']}"
    )
    return lines
