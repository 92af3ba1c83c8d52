"""The bench of the labelling page: waiting times, labelling effort, and what is written."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.table import Table

import tokt
from tests.chromium import chromium
from tests.load.effort.effort import LabellingEffort, measure_effort
from tests.load.effort.stretches import FRAMES
from tests.load.program import label_server
from tests.load.report import Found, Timing, machine_words, table, yes_or_no
from tokt.cli.output import progress
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.common.terminal import say
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.store.store import FILE_NAME
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets.mission_list import named_missions
from tokt.training.datasets.mission_source import LabelledMission, labelled_missions

from .chart import label_chart_png
from .mission import copy_frames, label_all, link_frames
from .tab import ANNOTATOR, HEIGHT, WIDTH, Tab
from .times import FIRST_FRAME, Repeats, acknowledging, first_page, jumps, live_update, stepping

LABEL_FILE = "labels.csv"
MAX_PICTURES = 300  # so many different pictures at most, each linked to over and over


@dataclass(frozen=True)
class PageBenchSize:
    frames: int  # of the long mission
    rendered: int  # frames of a mission that is rendered for the bench
    width: int  # of these, in pixels
    repeats: Repeats
    held: int  # frames of a stretch that is labelled, by a model of all the rest
    stretches: int | None  # of each dive; None for all


FULL = PageBenchSize(10_000, 240, 1360, Repeats(7, 100, 40, 100, 20), FRAMES, None)
QUICK = PageBenchSize(300, 60, 360, Repeats(1, 3, 2, 3, 1), 6, 1)


def run_label_bench(
    mission: Path | None, labels: Path | None, extent: PageBenchSize, times: bool, effort: bool
) -> Found:
    """Measure the labelling page: its waiting times, the effort of labelling, or both.

    Without a mission one is rendered and thrown away; the labels of a mission are in its folder's
    ``labels.csv`` unless a file is given. A list of missions is for the effort: each stretch is
    labelled with a model of all the others. Raises ToktError if these cannot be used, there is no
    browser to measure with, or the page does not answer.
    """
    if labels is not None and mission is None:
        raise ToktError("--labels goes together with --mission")
    waited: list[Timing] = []
    efforts: list[LabellingEffort] = []
    with tempfile.TemporaryDirectory(prefix="tokt-bench-") as name, chromium() as browser:
        folder = Path(name)
        if mission is None:
            say("-- render a mission")
            tokt.simulate_mission(
                folder / "rendered", n_frames=extent.rendered, width=extent.width, progress=progress
            )
        shown = mission or folder / "rendered"
        if effort:
            dives = _labelled(shown, labels, folder)
            efforts = measure_effort(dives, extent.held, extent.stretches, browser)
        if times:
            first = open_mission(named_missions(shown)[0].path)
            waited = _measure_times(first, extent, folder, browser)
        browser_name = f"Chromium {browser.version}, headless, {WIDTH}x{HEIGHT}"
    found = {
        "times": [time.to_json() for time in waited],
        "effort": [each.to_json() for each in efforts],
        "machine": machine(),
        "browser": browser_name,
        "playwright": version("playwright"),
        "mission": "rendered" if mission is None else mission.resolve().name,
        "frames": extent.frames if times else None,
    }
    wrong = any(each.wrong for each in efforts)
    fault = "not every label came out as it was asked for" if wrong else ""
    chart = label_chart_png(waited, efforts, found)
    return Found("label", found, label_report(found), chart, fault)


def _labelled(mission: Path, labels: Path | None, workspace: Path) -> list[LabelledMission]:
    """The missions with the labels to reproduce. Raises ToktError if there are none."""
    file = labels or mission / LABEL_FILE
    listed = labels is None and all(one.labels for one in named_missions(mission))
    if not listed and not file.is_file():
        raise ToktError(f"no label file {file}: --effort has nothing to reproduce (see --labels)")
    files = [] if listed else [file]
    return labelled_missions([mission], files, workspace, Taxonomy.load(), DEFAULT_GRID, say)


def _measure_times(mission, extent, folder, browser) -> list[Timing]:
    """Make a long mission of links and measure the page on it, empty and fully labelled."""
    say(f"-- a mission of {extent.frames} frames")
    copy_frames(mission, mission.frames()[:MAX_PICTURES], folder / "pictures")
    long = folder / "long"
    link_frames(folder / "pictures" / "Left", long, extent.frames)
    say("-- the page without labels")
    empty = _page_times(long, folder / "empty", extent, browser, once=True)
    full = folder / "full"
    count = label_all(full / FILE_NAME, long.name, extent.frames, ANNOTATOR)
    say(f"-- the page with {count:,} labels")
    for time in _page_times(long, full, extent, browser, once=False):
        what = f"{time.what}; {count:,} labels in the store"
        empty.append(replace(time, name=f"{time.name}_labelled", what=what))
    return empty


def _page_times(mission, workspace, extent, browser, once) -> list[Timing]:
    repeats = extent.repeats
    with label_server(mission, workspace, "--annotator", ANNOTATOR) as url:
        times = [first_page(browser, url, repeats.loads)]
        tab = Tab(browser, url)
        tab.open(FIRST_FRAME)
        times += stepping(tab, repeats.steps)
        if once:
            times.append(jumps(tab, extent.frames, repeats.jumps))
        times += acknowledging(tab, range(DEFAULT_GRID.n_patches), repeats.clicks)
        tab.close()
        if once:
            times.append(live_update(browser, url, Taxonomy.load().names, repeats.changes))
    return times


def label_report(found: Mapping[str, Any]) -> list[Table | str]:
    times, efforts = found["times"], found["effort"]
    frames = f", {found['frames']} frames of links to it" if found["frames"] else ""
    tables = [_table_of_times(times)] * bool(times) + [_table_of_efforts(efforts)] * bool(efforts)
    return [
        *tables,
        f"mission: {found['mission']}{frames}; {found['browser']}",
        machine_words(found),
        *(f"{effort['stretch']}: {text}" for effort in efforts for text in effort["wrong"]),
    ]


def _table_of_times(times: Sequence[Mapping[str, Any]]) -> Table:
    rows = [
        (
            time["name"],
            *(f"{time[figure]:.1f}" for figure in ("p50_ms", "p95_ms", "worst_ms")),
            "" if time["asked_ms"] is None else f"{time['asked_of']} {time['asked_ms']:g}",
            yes_or_no(time["holds"]),
            str(time["count"]),
            time["what"],
        )
        for time in times
    ]
    return table(("ms", "p50", "p95", "worst", "asked", "kept", "n", ""), rows, "")


def _table_of_efforts(efforts: Sequence[Mapping[str, Any]]) -> Table:
    headings = ("actions", "frames", "without", "with", "asked", "kept", "labels equal", "against")
    rows = [
        (
            f"{effort['stretch']}{', unsure too' if effort['unsure'] else ''}",
            *(str(effort[part]) for part in ("frames", "without", "with_model")),
            "" if effort["asked"] is None else f"{effort['asked']:.0f}",
            yes_or_no(effort["holds"]),
            yes_or_no(not effort["wrong"]),
            str(effort["against"]),
        )
        for effort in efforts
    ]
    return table(headings, rows, "")
