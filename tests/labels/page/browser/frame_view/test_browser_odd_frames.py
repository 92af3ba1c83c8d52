"""Frames and classes of all kinds in a real browser: unreadable, dark and bright; keys taken."""

import json

import cv2
import numpy as np
import pytest

from tests.fixtures import draw_tiny_frame
from tests.labels.page.colours import contrast, luminance
from tests.waiting import until
from tokt.labels.taxonomy import Taxonomy

DARK_CLASSES = {"night": ("#000000", "p"), "navy": ("#000080", "?")}
"""A user's classes whose lines nobody would see in their own colours, and the page's keys."""
WATERS = {1: (0, 0, 0), 3: (225, 215, 180)}
UNREADABLE = 2


@pytest.fixture(scope="module")
def server(page_server, tmp_path_factory):
    folder = tmp_path_factory.mktemp("odd")
    taxonomy = Taxonomy.load().to_json()["classes"]
    taxonomy += [
        {**taxonomy[1], "name": name, "color": color, "key": key}
        for name, (color, key) in DARK_CLASSES.items()
    ]
    lines = ["format = 1"]
    for known in taxonomy:
        lines += ["[[classes]]", *(f"{name} = {json.dumps(of)}" for name, of in known.items())]
    (folder / "taxonomy.toml").write_text("\n".join(lines))
    mission = folder / "tiny"
    mission.mkdir()
    for frame, water in WATERS.items():
        cv2.imwrite(str(mission / f"a_{frame}.png"), cv2.add(draw_tiny_frame(33), (*water, 0)))
    (mission / f"a_{UNREADABLE}.png").write_bytes(b"no picture")
    options = ("--annotator", "anna", "--taxonomy", folder / "taxonomy.toml")
    return page_server(*options, mission=mission)


def test_an_unreadable_frame_says_so_and_is_passed(open_frame):
    view = open_frame(1, allow="422")
    view.press("1", "d")
    view.shows("#status", "cannot be shown")
    view.click(5)
    view.press("d")
    view.wait(3)
    view.click(5)
    assert view.stored(UNREADABLE) == {} and view.stored(3) == {5: "ocean"}
    view.press("Control+z")
    view.saved()


def test_keys_of_the_taxonomy_win_and_page_keys_stay_reachable(open_frame):
    view = open_frame(3, allow="422")
    view.label("p", 3)
    view.label("?", 4)
    assert view.stored(3) == {3: "night", 4: "navy"}
    view.press("Alt+p")
    view.shows("#toast", "You have no labels on frame 2")
    view.press("Alt+?")
    text = view.text("#help")
    assert "Alt+p" in text and "Alt+?" in text
    view.press("Escape", "Control+z", "Control+z")
    view.saved()


def test_lines_around_labels_show_on_dark_and_bright_water(open_frame):
    view = open_frame(1, allow="422")
    view.page.evaluate(
        "() => import('/static/core/mission.js').then(({ setSetting }) =>"
        " { setSetting('enhance', 0); setSetting('grid', false); })"
    )
    names = [*Taxonomy.load().names[1:], *DARK_CLASSES, "unsure"]
    cells = {name: 11 + 2 * (at % 4) + 20 * (at // 4) for at, name in enumerate(names)}
    for frame in WATERS:
        for name, cell in cells.items():
            view.server.paint(f"{frame}-{name}", frame, [cell], name)
        view.open(frame)
        view.shows("#status", f"{len(names)} of 100")
        until(
            lambda: not lines_without_contrast(view, cells),
            lambda: lines_without_contrast(view, cells),
        )


def lines_without_contrast(view, cells):
    """Classes whose lines are drawn below a contrast of 3 to what lies on either side of them."""
    shot = np.frombuffer(view.page.screenshot(), np.uint8)
    seen = luminance(cv2.imdecode(shot, cv2.IMREAD_COLOR)[..., ::-1])
    faint = []
    for name, cell in cells.items():
        (x, y), (right, _) = view.at(cell), view.at(cell + 1)
        edge = round((x + right) / 2)
        line = seen[round(y), edge - 6 : edge + 1]
        inside, outside = seen[round(y), edge - 9], seen[round(y), edge + 3]
        if min(contrast(line, inside).max(), contrast(line, outside).max()) < 3:
            faint.append(name)
    return faint
