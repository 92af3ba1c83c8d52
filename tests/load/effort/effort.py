"""Labelling effort: actions that reproduce half a mission's labels, with a model and without."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.load.page.mission import copy_frames
from tokt.features.frames.mission import LEFT, Mission, format_frames
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy

from .halves import Half, choose_keep, labelled, train_on, two_halves
from .person import LabellingEffort, Person, Workflow
from .plan import Tools

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ASKED = 5.0
"""So many times fewer actions with suggestions."""
_CLICKS = Tools(drags=False, copying=False, sheet=True)
_IN_FRAMES = Tools(drags=False, copying=False, sheet=False)
_EVERYTHING = Tools(drags=True, copying=True, sheet=True)
WAYS = (
    Workflow("clicks", "a click a patch, contact sheet", _CLICKS, unsure=False, asked=ASKED),
    Workflow("clicks_unsure", "the same, unsure ones too", _CLICKS, unsure=True),
    Workflow("frames", "a click a patch, frame by frame", _IN_FRAMES, unsure=False),
    Workflow("frames_unsure", "the same, unsure ones too", _IN_FRAMES, unsure=True),
    Workflow("drags", "a drag is one action, all tools", _EVERYTHING, unsure=False),
    Workflow("drags_unsure", "the same, unsure ones too", _EVERYTHING, unsure=True),
)


class EffortBench:
    """Trains on each half and labels the other in a browser.

    Parameters
    ----------
    mission : Mission
    records : sequence of LabelRecord
        One annotator's labels of it.
    most : int or None
        Label only so many of a half's held-out frames; None for all.
    ways : sequence of Workflow
    halves : int
        1 or 2: how many of the two halves are labelled.
    """

    def __init__(
        self,
        mission: Mission,
        records: Sequence[LabelRecord],
        most: int | None,
        ways: Sequence[Workflow],
        halves: int,
    ) -> None:
        self._mission = mission
        self._records = [record for record in records if record.camera == LEFT]
        self._table = labelled(self._records, Taxonomy.load())
        self._most, self._ways, self._count = most, ways, halves

    def run(
        self, browser: Browser, progress: Callable[..., Any], say: Callable[[str], None]
    ) -> tuple[list[LabellingEffort], list[dict[str, Any]]]:
        """Label what is held out; the efforts, and what the halves were.

        Raises
        ------
        ToktError
            If the mission is too short to be halved, or the page does not do what it is told.
        """
        efforts = [LabellingEffort(way) for way in self._ways]
        about = []
        for half in two_halves(self._table.numbers)[: self._count]:
            with tempfile.TemporaryDirectory(prefix="tokt-effort-") as name:
                about.append(self._label_half(half, Path(name), efforts, browser, progress, say))
        return efforts, about

    def _label_half(
        self,
        half: Half,
        folder: Path,
        efforts: Sequence[LabellingEffort],
        browser: Browser,
        progress: Callable[..., Any],
        say: Callable[[str], None],
    ) -> dict[str, Any]:
        say(f"-- train on {len(half.learnt)} frames, label {len(half.held)}")
        trained, bundle = train_on(self._mission, self._records, half, folder, progress)
        held = half.held if self._most is None else self._around_obstacles(half.held, self._most)
        target = folder / "held"
        copy_frames(self._mission, held, target)
        person = Person(browser, target, folder, held, self._table)
        keep = choose_keep(trained, self._table, _CLICKS, person.sheet_frames())
        for effort in progress(efforts, len(efforts), "label"):
            effort.without.append(person.label(effort, None, keep))
            effort.with_model.append(person.label(effort, bundle, keep))
        rows = self._table.target(held, unsure=True)
        return {
            "trained_on": format_frames(half.learnt),
            "held_out": format_frames(held),
            "gap_frames": half.gap,
            "model": trained.request.extractor_name,
            "keep": keep,
            "patches": {
                name: int((rows == index).sum()) for index, name in enumerate(self._table.names)
            },
        }

    def _around_obstacles(self, held: list[int], most: int) -> list[int]:
        """Some frames in a row in which something is to be seen."""
        rows = self._table.rows(held)
        counts = (rows == self._table.kinds.obstacle).sum(axis=1)
        sums = np.convolve(counts, np.ones(most), "valid")
        first = int(sums.argmax()) if len(sums) else 0
        return held[first : first + most]
