"""Plans of page actions: performed on the page, in Python or in Chromium, they give the labels."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from tests.load.effort.effort import WAYS
from tests.load.effort.halves import Labelled, labelled, two_halves
from tests.load.effort.page import FREE, NONE, HeldLabels, Kinds, Page, PageAction, PageSuggestions
from tests.load.effort.person import LabellingEffort, Person, Workflow
from tests.load.effort.plan import ActionPlanner, LabellingTask, Tools
from tests.load.effort.strokes import clicks, drags
from tests.load.page.browser import chromium
from tests.load.page.mission import copy_frames
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets.mission_source import read_labels

GRID = (3, 4)
CELLS = GRID[0] * GRID[1]
CLEAR, TOWER, REEF, UNSURE = range(4)
KINDS = Kinds((False, True, True, False), CLEAR, TOWER)
MASKS = npst.arrays(bool, GRID)
EVERY_TOOLS = [
    Tools(drags, copying, sheet)
    for drags in (False, True)
    for copying in (False, True)
    for sheet in (False, True)
]


def around(cell: int) -> set[int]:
    """Cells across an edge."""
    row, col = divmod(cell, GRID[1])
    near = {(row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)}
    return {r * GRID[1] + c for r, c in near if 0 <= r < GRID[0] and 0 <= c < GRID[1]}


def area_of(cell: int, may: set[int]) -> frozenset[int]:
    """All cells that can be reached from one inside `may`."""
    found, new = {cell}, {cell}
    while new:
        new = {n for one in new for n in around(one) & may} - found
        found |= new
    return frozenset(found)


@given(MASKS, MASKS)
def test_drags_paint_what_they_must_and_nothing_they_may_not(need: Any, also: Any) -> None:
    paths = drags(need, need | also)
    needed = set(np.flatnonzero(need).tolist())
    allowed = set(np.flatnonzero(need | also).tolist())
    painted = {cell for path in paths for cell in path}
    assert needed <= painted <= allowed
    assert all(b in around(a) for path in paths for a, b in pairwise(path))
    assert len(paths) == len({area_of(cell, allowed) for cell in needed})


@given(MASKS)
def test_a_click_paints_one_patch(need: Any) -> None:
    assert clicks(need) == [(int(cell),) for cell in np.flatnonzero(need)]


@st.composite
def problems(draw: Any) -> tuple[LabellingTask, PageSuggestions | None]:
    """Up to seven frames with labels, some of which do not matter, perhaps with a model."""
    count = draw(st.integers(1, 7))
    labels = npst.arrays(np.int16, (count, CELLS), elements=st.integers(CLEAR, UNSURE))
    target = draw(labels)
    target[draw(npst.arrays(bool, (count, CELLS)))] = FREE
    if draw(st.booleans()):  # many frames alike
        target[:] = target[0]
    task = LabellingTask(target, GRID, CLEAR, draw(st.integers(1, 4)))
    if draw(st.booleans()):
        return task, None
    values = draw(npst.arrays(float, (count, CELLS), elements=st.floats(-4, 4)))
    steps = draw(st.lists(st.integers(1, 8), min_size=count, max_size=count))
    numbers = tuple(int(number) for number in np.cumsum(steps))
    return task, PageSuggestions(values, numbers, KINDS, draw(st.sampled_from((0.0, 1.0, 2.5))))


def perform(
    task: LabellingTask, suggestions: PageSuggestions | None, plan: list[PageAction]
) -> Page:
    """The page after a plan."""
    page = Page(np.full(task.target.shape, NONE, np.int16), suggestions, CLEAR, task.sheet_frames)
    for action in plan:
        page.perform(action)
    return page


@given(problems(), st.sampled_from(EVERY_TOOLS))
@settings(deadline=None, max_examples=60)
def test_a_plan_gives_the_labels_asked_for(
    problem: tuple[LabellingTask, PageSuggestions | None], tools: Tools
) -> None:
    task, suggestions = problem
    plan = ActionPlanner(task, tools).plan(suggestions)
    labels = perform(task, suggestions, plan).labels
    matters = task.target != FREE
    np.testing.assert_array_equal(labels[matters], task.target[matters])
    kinds = {action.kind for action in plan}
    assert tools.sheet or "sheet" not in kinds
    assert tools.copying or not kinds & {"copy", "paint_all"}
    assert tools.drags or all(len(action.path) <= 1 for action in plan)
    slack = len(task.target)  # each frame in its cheapest way may need one more class key
    assert len(plan) <= len(ActionPlanner(task, CLICKS).plan(None)) + slack


def one(rows: list[str]) -> Any:
    """A target of one frame: . clear, T tower, ? unsure, and a space for what does not matter."""
    meaning = {".": CLEAR, "T": TOWER, "?": UNSURE, " ": FREE}
    return np.array([[meaning[sign] for row in rows for sign in row]], np.int16)


def kinds_of(target: Any, tools: Tools, suggestions: PageSuggestions | None = None) -> list[str]:
    task = LabellingTask(target, GRID, CLEAR, 4)
    return [action.kind for action in ActionPlanner(task, tools).plan(suggestions)]


DRAGS, CLICKS = Tools(True, False, False), Tools(False, False, False)


def test_the_fewest_actions_for_what_a_person_sees_at_once() -> None:
    tower = one([".T..", ".TT.", "..T."])
    assert kinds_of(tower, DRAGS) == ["choose", "paint", "rest"]
    assert kinds_of(tower, CLICKS) == ["choose", *["paint"] * 4, "rest"]
    apart = one(["T..T", "....", "...."])
    assert kinds_of(apart, DRAGS).count("paint") == 2
    # One stroke through what does not matter, or through what is painted over afterwards.
    assert kinds_of(one(["T  T", "....", "...."]), DRAGS).count("paint") == 1
    assert kinds_of(one(["T??T", "....", "...."]), DRAGS).count("paint") == 2
    assert kinds_of(one(["....", "....", "...."]), DRAGS) == ["rest"]
    assert kinds_of(one(["    ", "    ", "    "]), DRAGS) == []


def test_suggestions_that_are_right_cost_one_key_a_frame_or_a_sheet() -> None:
    target = one([".T..", ".TT.", "..T."]).repeat(6, axis=0)
    values = np.where(target == TOWER, 1.0, -1.0)
    says = PageSuggestions(values, tuple(range(6)), KINDS, 2.0)
    assert kinds_of(target, CLICKS, says) == ["accept"] * 6
    assert kinds_of(target, Tools(False, False, True), says) == ["sheet", "accept", "accept"]


def test_what_was_corrected_is_kept_in_the_frames_after_it() -> None:
    target = one([".T..", "....", "...."]).repeat(4, axis=0)
    values = np.full(target.shape, -1.0)
    far = PageSuggestions(values, (1, 2, 3, 9), KINDS, 2.0)
    assert kinds_of(target, CLICKS, far).count("paint") == 2  # once more behind the gap
    alone = PageSuggestions(values, (1, 2, 3, 4), KINDS, 0.0)
    assert kinds_of(target, CLICKS, alone).count("paint") == 4
    sure = PageSuggestions(values * 3, (1, 2, 3, 4), KINDS, 2.0)
    assert kinds_of(target, CLICKS, sure).count("paint") == 4


def followed(mine: bool) -> Any:
    """What is suggested in the second of two frames, and whether it goes back to a label."""
    before = np.array([UNSURE, UNSURE, UNSURE, TOWER, TOWER, REEF, CLEAR, CLEAR, NONE, NONE, 0, 0])
    values = np.array([[2.0, -2.0, 2.1, -1.9, -2.0, 9.0, 1.9, 2.0, 0.1, -9.0, 0.0, -3.0]])
    says = PageSuggestions(values.repeat(2, axis=0), (1, 2), KINDS, 2.0)
    return says.of(1, HeldLabels(before.astype(np.int16), np.full(CELLS, mine) & (before != NONE)))


def test_what_held_before_is_kept_while_the_model_does_not_contradict_it() -> None:
    labels = [UNSURE, UNSURE, TOWER, TOWER, CLEAR, REEF, CLEAR, TOWER, TOWER, CLEAR, CLEAR, CLEAR]
    assert followed(mine=True).labels.tolist() == labels
    kept = [True, True, False, True, False, True, True, False, False, False, True, True]
    assert followed(mine=True).mine.tolist() == kept


def test_what_nobody_said_is_not_kept_against_an_obstacle() -> None:
    labels = [TOWER, UNSURE, TOWER, TOWER, CLEAR, REEF, TOWER, TOWER, TOWER, CLEAR, CLEAR, CLEAR]
    assert followed(mine=False).labels.tolist() == labels
    assert not followed(mine=False).mine.any()


def test_only_frames_behind_a_label_of_mine_follow() -> None:
    values = np.array([[-1.0] * CELLS, [1.0] * CELLS, [-1.0] * CELLS])
    page = Page(
        np.full((3, CELLS), NONE, np.int16), PageSuggestions(values, (1, 2, 3), KINDS, 2.0), 0, 3
    )
    assert page.suggested(2).tolist() == [CLEAR] * CELLS
    page.labels[1, 0] = REEF
    assert page.suggested(2).tolist() == [REEF] + [TOWER] * (CELLS - 1)
    page.labels[0, :2] = CLEAR
    assert page.suggested(1).tolist() == [CLEAR, CLEAR] + [TOWER] * (CELLS - 2)
    page.labels[0] = CLEAR
    assert page.suggested(2).tolist() == [REEF] + [CLEAR] * (CELLS - 1)


def test_the_page_knows_no_other_action() -> None:
    page = Page(np.full((1, CELLS), NONE, np.int16), None, CLEAR, 4)
    with pytest.raises(ValueError, match="no action 'dance'"):
        page.perform(PageAction("dance"))


@pytest.mark.parametrize(
    "numbers", [range(1, 247), range(1, 41), [*range(1, 100), *range(132, 247)]]
)
def test_halves_are_whole_blocks_with_a_gap(numbers: Any) -> None:
    first, second = two_halves(list(numbers))
    assert sorted(first.held + second.held) == list(numbers)
    for half in (first, second):
        apart = [min(abs(a - b) for b in half.held) for a in half.learnt]
        assert min(apart) == half.gap + 1
        assert len({number // half.block for number in half.learnt}) >= 5


def test_a_mission_of_water_only_has_nothing_to_suggest(tiny: Any) -> None:
    records = read_labels([tiny.labels], Taxonomy.load(), DEFAULT_GRID)
    with pytest.raises(ToktError, match="no patch is labelled as an obstacle"):
        labelled([record for record in records if record.label == "ocean"], Taxonomy.load())


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium, or the reason why there is none."""
    pytest.importorskip("playwright", reason="Playwright is not installed (extra dev)")
    if not any(map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))):
        pytest.skip("no Chromium on this computer")
    with chromium() as started:
        yield started


@pytest.fixture
def table(tiny: Any) -> Labelled:
    """The tiny mission's labels."""
    return labelled(read_labels([tiny.labels], Taxonomy.load(), DEFAULT_GRID), Taxonomy.load())


HELD = [8, 9, 20]
FRAME_BY_FRAME = next(way for way in WAYS if way.name == "frames")
EVERYTHING = Workflow("everything", "all tools", Tools(True, True, True), unsure=True)


def test_plans_performed_in_the_browser_give_the_labels(
    browser: Any, tiny: Any, tiny_bundle: Path, table: Labelled, tmp_path: Path
) -> None:
    copy_frames(open_mission(tiny.path), HELD, tmp_path / "held")
    person = Person(browser, tmp_path / "held", tmp_path, HELD, table)
    assert person.sheet_frames() == len(HELD)
    everything, frames = LabellingEffort(EVERYTHING), LabellingEffort(FRAME_BY_FRAME)
    assert person.label(everything, None, keep=2.0) < 20
    assert person.label(frames, tiny_bundle, keep=2.0) > len(HELD)
    assert everything.wrong == frames.wrong == []
    with LabelStore(tmp_path / "workspace1" / FILE_NAME, create=False) as store:
        stored = {(r.frame, r.row, r.col): r.label for r in store.current()}
    truth = {(frame, *divmod(cell, 10)): table.names[label] for frame in HELD
             for cell, label in enumerate(table.rows([frame])[0])}  # fmt: skip
    assert stored == truth


def test_a_wrong_label_in_the_store_is_told(tiny: Any, table: Labelled, tmp_path: Path) -> None:
    target = table.target([8, 9], unsure=True)
    records = read_labels([tiny.labels], Taxonomy.load(), DEFAULT_GRID)
    with LabelStore(tmp_path / FILE_NAME) as store:
        store.add(record for record in records if record.frame in (8, 9))
    person = Person(None, tiny.path, tmp_path, [8, 9], table)  # type: ignore[arg-type]
    assert person.wrong(tmp_path, target) == []
    target[1, 44] = UNSURE
    target[0, :7] = UNSURE
    found = person.wrong(tmp_path, target)
    assert found[0].startswith("frame 8 patch 0: ocean instead of ")
    assert len(found) == 6 and found[-1] == "and 3 more"
