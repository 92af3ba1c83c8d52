"""Somebody who labels frames in the browser, with suggestions or without, and what it took."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.load.page.server import label_server
from tests.load.page.tab import Tab
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.labels.store.store import FILE_NAME, LabelStore

from .browser import Performer, empty_page, frames_on_a_sheet, suggested_values
from .halves import Labelled
from .page import FREE, Labels, PageSuggestions
from .plan import ActionPlanner, LabellingTask, Tools

if TYPE_CHECKING:
    from playwright.sync_api import Browser

_LISTED = 5
_ANNOTATOR = "bench"


@dataclass(frozen=True)
class Workflow:
    """How a person works, the same with suggestions and without.

    Parameters
    ----------
    name, words : str
    tools : Tools
    unsure : bool
        Whether ``unsure`` patches, which nothing learns from, must be reproduced too.
    asked : float or None
    """

    name: str
    words: str
    tools: Tools
    unsure: bool
    asked: float | None = None


@dataclass
class LabellingEffort:
    """Actions of one way, added up over the halves.

    Parameters
    ----------
    way : Workflow
    without, with_model : list of int
        Keys, clicks and drags for each half.
    wrong : list of str
        Patches whose stored label is not the one asked for, after the actions were performed.
    """

    way: Workflow
    without: list[int] = field(default_factory=list)
    with_model: list[int] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    @property
    def ratio(self) -> float:
        """How many times fewer actions suggestions need."""
        return sum(self.without) / sum(self.with_model)

    @property
    def holds(self) -> bool | None:
        """Whether it is as many times fewer as asked; None where nothing is asked."""
        return None if self.way.asked is None else self.ratio >= self.way.asked

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            "name": self.way.name,
            "way": self.way.words,
            "unsure_reproduced": self.way.unsure,
            "without": self.without,
            "with": self.with_model,
            "ratio": self.ratio,
            "asked": self.way.asked,
            "holds": self.holds,
            "labels_equal": not self.wrong,
            "wrong": self.wrong,
        }


class Person:
    """Somebody who labels the held-out frames in the browser, each time from the start."""

    def __init__(
        self, browser: Browser, mission: Path, folder: Path, numbers: list[int], table: Labelled
    ) -> None:
        self._browser, self._mission, self._folder = browser, mission, folder
        self._numbers, self._table = numbers, table
        self._sheet = 0
        self._times = 0

    def sheet_frames(self) -> int:
        """How many frames the contact sheet shows at a time."""
        if not self._sheet:
            with label_server(self._mission, self._folder / "look") as url:
                tab = Tab(self._browser, url)
                tab.open(f"#/label/left/{self._numbers[0]}")
                self._sheet = frames_on_a_sheet(tab, self._numbers[0])
                tab.close()
            if self._sheet >= len(self._numbers):
                self._sheet = len(self._numbers)
        return self._sheet

    def label(self, effort: LabellingEffort, bundle: Path | None, keep: float) -> int:
        """Label all frames; the number of actions. What came out wrong goes into `effort`."""
        self._times += 1
        workspace = self._folder / f"workspace{self._times}"
        options = ["--annotator", _ANNOTATOR]
        if bundle is not None:
            options += ["--model", str(bundle)]
        obstacle = self._table.names[self._table.kinds.obstacle]
        settings = {"confidence": 0, "follow": keep, "obstacleAs": obstacle}
        target = self._table.target(self._numbers, effort.way.unsure)
        with label_server(self._mission, workspace, options) as url:
            tab = Tab(self._browser, url, settings)
            tab.open(f"#/label/left/{self._numbers[0]}")
            says = None if bundle is None else self._suggestions(tab, keep)
            actions = self._plan_and_perform(tab, target, effort.way.tools, says)
            tab.close()
        words = "with suggestions" if bundle else "without suggestions"
        effort.wrong += [f"{words}: {text}" for text in self.wrong(workspace, target)]
        return actions

    def _suggestions(self, tab: Tab, keep: float) -> PageSuggestions:
        values = suggested_values(tab, self._numbers)
        return PageSuggestions(values, tuple(self._numbers), self._table.kinds, keep)

    def _plan_and_perform(
        self, tab: Tab, target: Labels, tools: Tools, says: PageSuggestions | None
    ) -> int:
        grid = (DEFAULT_GRID.rows, DEFAULT_GRID.cols)
        task = LabellingTask(target, grid, self._table.kinds.clear, self.sheet_frames())
        plan = ActionPlanner(task, tools).plan(says)
        shape = (target.shape[0], target.shape[1])
        page = empty_page(shape, self._table.kinds.clear, task.sheet_frames, says)
        Performer(tab, self._numbers, page, self._table.names).perform(plan)
        return len(plan)

    def wrong(self, workspace: Path, target: Labels) -> list[str]:
        """What the store holds and should not, or holds not and should."""
        with LabelStore(workspace / FILE_NAME, create=False) as store:
            stored = store.current(mission=self._mission.name)
        held = np.full(target.shape, FREE, np.int16)
        row_of = {number: row for row, number in enumerate(self._numbers)}
        for record in stored:
            cell = record.row * DEFAULT_GRID.cols + record.col
            held[row_of[record.frame], cell] = self._table.names.index(str(record.label))
        wrong = np.argwhere((target != FREE) & (held != target))
        found = [
            f"frame {self._numbers[row]} patch {cell}: {self._name(held[row, cell])} "
            f"instead of {self._name(target[row, cell])}"
            for row, cell in wrong[:_LISTED]
        ]
        return found + ([f"and {len(wrong) - _LISTED} more"] if len(wrong) > _LISTED else [])

    def _name(self, label: int) -> str:
        return "nothing" if label < 0 else self._table.names[label]
