"""Labelling effort: actions that reproduce half a mission's labels, with a model and without."""

import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.load.page.mission import copy_frames
from tests.load.page.tab import ANNOTATOR, Tab
from tests.load.program import label_server
from tokt.cli.output import progress, say
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import LEFT, format_frames
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import UNSURE, Taxonomy

from .halves import labels_by_frame, most_frequent_obstacle, target_of, train_on, two_halves
from .session import FREE, LabelSession, Target, Workflow

WAYS = (
    Workflow("clicks", "a click a patch, contact sheet", True, False, False, asked=5.0),
    Workflow("clicks_unsure", "the same, unsure ones too", True, False, True),
    Workflow("frames", "a click a patch, frame by frame", False, False, False),
    Workflow("frames_unsure", "the same, unsure ones too", False, False, True),
    Workflow("drags", "a drag is one action, all tools", True, True, False),
    Workflow("drags_unsure", "the same, unsure ones too", True, True, True),
)
FOLLOW = 2.0
"""How long to keep what held in the frame before: as the page does unless it is told."""
_LISTED = 5


@dataclass
class LabellingEffort:
    """Actions of one way, added up over the halves."""

    way: Workflow
    without: list[int] = field(default_factory=list)  # keys, clicks and drags for each half
    with_model: list[int] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """Patches whose stored label is not the one asked for, after the actions were performed."""

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


def measure_effort(mission, records, most, ways, halves, browser):
    """Train on each half and label the other in a browser; the efforts, and what the halves were.

    The records are one annotator's labels of the mission. Of 1 or 2 `halves` `most` of the frames
    held out are labelled, None for all. Raises ToktError if the mission is too short to be halved,
    or the page does not do what it is told.
    """
    labels = labels_by_frame(records)
    obstacle = most_frequent_obstacle(labels)
    left = [record for record in records if record.camera == LEFT]
    efforts = [LabellingEffort(way) for way in ways]
    about = []
    for half in two_halves(list(labels))[:halves]:
        held = half.held if most is None else _around_obstacles(labels, obstacle, half.held, most)
        say(f"-- train on {len(half.learnt)} frames, label {len(half.held)}")
        with tempfile.TemporaryDirectory(prefix="tokt-effort-") as name:
            folder = Path(name)
            extractor, bundle = train_on(mission, left, half, folder)
            copy_frames(mission, held, folder / "held")
            for effort in progress(efforts, len(efforts), "label"):
                target = target_of(labels, held, effort.way.unsure)
                for model, counts in ((None, effort.without), (bundle, effort.with_model)):
                    words = "without suggestions" if model is None else "with suggestions"
                    places = (folder / "held", folder / f"{effort.way.name} {words}")
                    actions = label_on_page(browser, *places, target, effort.way, model, obstacle)
                    counts.append(actions)
                    effort.wrong += [f"{words}: {text}" for text in wrong_labels(places[1], target)]
        said = Counter(label for number in held for label in labels[number])
        about.append(
            {
                "trained_on": format_frames(half.learnt),
                "held_out": format_frames(held),
                "gap_frames": half.gap,
                "model": extractor,
                "keep": FOLLOW,
                "patches": {name: said[name] for name in (*Taxonomy.load().names, UNSURE)},
            }
        )
    return efforts, about


def _around_obstacles(labels: Target, obstacle: str, held: list[int], most: int) -> list[int]:
    """Some frames in a row in which something is to be seen."""
    counts = [labels[number].count(obstacle) for number in held]
    sums = np.convolve(counts, np.ones(most), "valid")
    first = int(sums.argmax()) if len(held) >= most else 0
    return held[first : first + most]


def label_on_page(browser, mission, workspace, target: Target, way: Workflow, model, obstacle):
    """Give all frames of a mission their labels in the browser; the number of actions.

    `model` is the bundle that suggests labels, `obstacle` the class that its "obstacle" stands for.
    """
    options = () if model is None else ("--model", model)
    settings = {"confidence": 0, "follow": FOLLOW, "obstacleAs": obstacle}
    with label_server(mission, workspace, "--annotator", ANNOTATOR, *options) as url:
        tab = Tab(browser, url, settings)
        tab.open(f"#/label/left/{next(iter(target))}")
        actions = LabelSession(tab, target, way, model is not None).run()
        tab.close()
    return actions


def wrong_labels(workspace: Path, target: Target) -> list[str]:
    """What a workspace's store holds and should not, or holds not and should."""
    with LabelStore(workspace / FILE_NAME, create=False) as store:
        held = labels_by_frame(store.current())
    nothing = [None] * DEFAULT_GRID.n_patches
    wrong = [
        f"frame {number} patch {cell}: {said or 'nothing'} instead of {want}"
        for number, labels in target.items()
        for cell, (want, said) in enumerate(zip(labels, held.get(number, nothing), strict=True))
        if want is not FREE and said != want
    ]
    more = [f"and {len(wrong) - _LISTED} more"] if len(wrong) > _LISTED else []
    return wrong[:_LISTED] + more
