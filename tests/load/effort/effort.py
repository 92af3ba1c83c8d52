"""Labelling effort: actions that reproduce the labels of a stretch, with a model and without."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.load.page.mission import copy_frames
from tests.load.page.tab import ANNOTATOR, Tab
from tests.load.program import label_server
from tokt.cli.output import progress
from tokt.features.common.terminal import say
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.training.datasets.mission_source import LabelledMission

from .session import FREE, LabelSession, Target
from .stretches import (
    FRAMES,
    Stretch,
    labels_by_frame,
    most_frequent_obstacle,
    stretches_of,
    target_of,
    train_without,
)

ASKED = 60  # actions with suggestions for `FRAMES` frames, unsure patches left as they come
_LISTED = 5
_SET_OBSTACLE = """async (value) => {
  const { post } = await import("/static/core/api.js");
  const { takeNews } = await import("/static/core/mission.js");
  takeNews(await post("/api/settings", { name: "obstacle_as", value }));
  document.getElementById("question").close();
}"""


@dataclass
class LabellingEffort:
    """Keys, clicks and drags that one stretch took."""

    stretch: str
    frames: int
    unsure: bool  # whether unsure patches, which nothing learns from, are reproduced too
    without: int = 0
    with_model: int = 0
    against: int = 0  # patches made clear by no stroke on them, where the model says obstacle
    wrong: list[str] = field(default_factory=list)
    """Patches whose stored label is not the one asked for, after the actions were performed."""

    @property
    def asked(self) -> int | None:
        return None if self.unsure or self.frames < FRAMES else ASKED

    @property
    def holds(self) -> bool | None:
        return None if self.asked is None else self.with_model <= self.asked and not self.against

    def to_json(self) -> dict[str, Any]:
        return {**vars(self), "asked": self.asked, "holds": self.holds}


def measure_effort(dives: Sequence[LabelledMission], most: int, stretches: int | None, browser):
    """Label each stretch in a browser, with a model of all the rest; the efforts.

    Of each dive the first `stretches` of `most` frames are labelled; None for all. Raises ToktError
    if there is too little to learn from, or the page does not do what it is told.
    """
    every = [one for dive in dives for one in stretches_of(dive, most)[:stretches]]
    efforts = []
    for stretch in progress(every, len(every), "label"):
        say(f"-- train without {stretch.name}, label it")
        with tempfile.TemporaryDirectory(prefix="tokt-effort-") as name:
            bundle = train_without(dives, stretch, Path(name))
            efforts += [effort_of(stretch, bundle, unsure, browser) for unsure in (False, True)]
    return efforts


def effort_of(stretch: Stretch, bundle: Path, unsure: bool, browser) -> LabellingEffort:
    labels = stretch.labels
    target = target_of(labels, stretch.held, unsure)
    effort = LabellingEffort(stretch.name, len(stretch.held), unsure)
    obstacle = most_frequent_obstacle({number: labels[number] for number in stretch.held})
    with tempfile.TemporaryDirectory(prefix="tokt-effort-") as name:
        frames = Path(name) / "held"
        copy_frames(stretch.dive.mission, stretch.held, frames)
        for model, words in ((None, "without"), (bundle, "with")):
            workspace = Path(name) / words
            session = label_on_page(browser, frames, workspace, target, model, obstacle)
            if model is None:
                effort.without = session.actions
            else:
                effort.with_model, effort.against = session.actions, session.against
            effort.wrong += [f"{words}: {text}" for text in wrong_labels(workspace, target)]
    return effort


def label_on_page(browser, mission, workspace, target: Target, model, obstacle) -> LabelSession:
    """Give all frames of a mission their labels in the browser; how that went.

    `model` is the bundle that suggests labels, `obstacle` the class that its "obstacle" stands for.
    """
    options = () if model is None else ("--model", model)
    with label_server(mission, workspace, "--annotator", ANNOTATOR, *options) as url:
        tab = Tab(browser, url)
        tab.open(f"#/label/left/{next(iter(target))}")
        if model is not None:
            tab.page.evaluate(_SET_OBSTACLE, obstacle)
        session = LabelSession(tab, target, model is not None)
        session.run()
        tab.close()
    return session


def wrong_labels(workspace: Path, target: Target) -> list[str]:
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
