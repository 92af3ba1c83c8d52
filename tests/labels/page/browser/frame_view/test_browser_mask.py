"""The mask in a real browser: drawn, saved, shown, and respected by every way to give a label."""

import shutil

import cv2
import numpy as np
import pytest

from tests.labels.page.colours import contrast, luminance
from tests.waiting import until
from tokt.features.frames.grid import Grid
from tokt.features.frames.mask_file import mask_file
from tokt.features.frames.view_mask import read_masks

GRID = Grid()
CLOCK = [7, 8, 9]
NIGHT, SNOW = 11, 12  # frames


@pytest.fixture(scope="module")
def dive(tiny, tmp_path_factory):
    """The tiny mission with a clock that never moves, a dark frame and a bright one."""
    folder = shutil.copytree(tiny.path, tmp_path_factory.mktemp("masked") / "tiny")
    for frame in range(1, 41):
        path = folder / f"Left/tiny_L_{frame}.png"
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if frame in (NIGHT, SNOW):
            picture[:] = {NIGHT: 2, SNOW: 250}[frame]
        cv2.putText(picture, "ROV 123", (262, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.7, 200, 2)
        cv2.imwrite(str(path), picture)
    return folder


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle, dive):
    return page_server("--annotator", "anna", "--model", tiny_bundle, mission=dive)


@pytest.fixture(autouse=True)
def unmasked(server):
    """Each test begins without a mask."""
    set_mask(server, [])


def set_mask(server, cells):
    server.post("/api/mask", who="ben", camera="left", cells=cells)


def masked(dive):
    """The masked patches by the file beside the frames."""
    return np.flatnonzero(read_masks(dive).patches("left", GRID, 272, 360)).tolist()


def toast(view, text):
    view.shows("#toast", text)


def says(view, cell, text):
    """Whether the status says this of a patch."""
    view.point(cell)
    view.shows("#status", text)


def test_a_mask_is_painted_with_the_mouse_and_saved(open_frame, dive):
    view, other = open_frame(1), open_frame(2, who="ben")
    view.page.get_by_role("button", name="Mask", exact=True).click()
    bar = view.page.get_by_role("group", name="Mask")
    view.shows(".mask-bar", "Click or drag over what is no view")
    view.drag(7, 9)
    view.click(90)
    view.shows(".mask-bar", "4 patches are masked, 4 not saved")
    view.drag(90, 91)  # as the first one: it becomes view again
    view.shows(".mask-bar", "3 patches are masked, 3 not saved")
    says(view, 8, "masked: no view, the mask is not saved yet")
    assert not mask_file(dive).exists() and view.stored(1) == {}
    view.press("d")  # it is of all frames
    view.wait(2)
    says(view, 8, "masked: no view")
    bar.get_by_role("button", name="Save mask").click()
    toast(view, "Saved: 3 patches are masked in all left frames.")
    assert masked(dive) == CLOCK
    view.shows("#status", "0 of 97 labelled")
    # Another person's page hears of it.
    other.shows("#status", "0 of 97 labelled")
    says(other, 9, "row 0, column 9: masked: no view")


def test_a_mask_is_drawn_by_keyboard_given_up_and_kept_for_later(open_frame, dive):
    view = open_frame(3)
    view.press("M", "Escape", "M", "ArrowDown", "ArrowRight", "Space")  # the cursor shows first
    view.shows("#announcer", "masked: no view: row 0, column 1")
    view.press("ArrowRight", "Shift+ArrowRight", "Shift+ArrowDown", "Space")
    view.shows(".mask-bar", "5 patches are masked, 5 not saved")
    view.press("3")  # a class: the mask waits
    toast(view, "The mask is not saved yet")
    assert not view.page.locator(".mask-bar").is_visible()
    assert view.stored(3) == {} and not mask_file(dive).exists()
    view.press("M")
    view.shows(".mask-bar", "5 not saved")
    view.press("Enter")
    toast(view, "Saved: 5 patches")
    saved = masked(dive)
    assert saved == [1, 2, 3, 12, 13]
    view.click(55)
    view.shows(".mask-bar", "1 not saved")
    view.page.get_by_role("group", name="Mask").get_by_role("button", name="Cancel").click()
    assert not view.page.locator(".mask-bar").is_visible()
    says(view, 55, "row 5, column 5: ")
    assert "masked" not in view.text("#status").partition("row 5")[2] and masked(dive) == saved


def test_a_mask_of_too_much_is_refused_in_a_sentence(open_frame, dive):
    view = open_frame(4, allow="409")
    view.press("M")
    for row in range(10):
        view.page.mouse.click(*view.row_head(row))
    view.shows(".mask-bar", "100 patches are masked, 100 not saved")
    view.page.get_by_role("button", name="Save mask").click()
    toast(view, "The mask is not saved: the mask covers 100 % of the view")
    assert not mask_file(dive).exists()
    view.shows(".mask-bar", "100 not saved")
    view.page.get_by_role("button", name="Cancel").click()


def test_no_way_of_labelling_reaches_a_masked_patch(open_frame, server):
    set_mask(server, CLOCK)
    view = open_frame(5)
    view.shows("#status", "of 97 labelled")
    view.page.wait_for_function(
        "() => /of 97 suggested patches/.test(document.querySelector('.model-said').textContent)"
    )
    view.label("3", 8)
    toast(view, "Masked: no view. A masked patch takes no label.")
    view.drag(6, 9)
    view.click(9, button="right")
    view.click_holding("Alt", 7)
    view.saved()
    assert view.stored(5) == {6: "sand"}
    view.press("Shift+Enter")
    view.saved()
    view.shows("#status", "97 of 97 labelled · done")
    assert {*view.stored(5)} == {*range(100)} - {*CLOCK}
    view.press("d", "p", "Shift+Enter", "o")  # copies, suggestions, the rest
    view.shows("#status", "97 of 97 labelled · done")
    view.saved()
    assert not {*view.stored(6)} & {*CLOCK}
    # Another page has not heard of it: the server says what it left out.
    view.page.evaluate(
        "() => import('/static/core/mission.js').then(({ maskedCells }) =>"
        " maskedCells('left').clear())"
    )
    view.open(7)
    view.label("3", 8)
    toast(view, "1 patch is masked as no view and took no label.")
    assert view.stored(7) == {}


def test_labels_from_before_are_hidden_and_come_back(open_frame, server):
    view = open_frame(8)
    view.label("4", 8, 50)
    view.saved()
    set_mask(server, CLOCK)
    view.shows("#status", "1 of 97 labelled, 1 hidden by the mask")
    assert view.stored(8) == {8: "reef", 50: "reef"}
    set_mask(server, [])
    view.shows("#status", "2 of 100 labelled")
    says(view, 8, "row 0, column 8: reef")


def test_what_never_moves_is_offered(open_frame, dive):
    view = open_frame(9)
    view.press("M")
    view.page.get_by_role("button", name="Find what never moves").click()
    toast(view, "3 patches show text or edges that never move: save to mask them.")
    view.shows(".mask-bar", "3 patches are masked, 3 not saved")
    assert not mask_file(dive).exists()
    view.press("Enter")
    toast(view, "Saved: 3 patches")
    assert masked(dive) == CLOCK
    view.page.get_by_role("button", name="Find what never moves").click()
    toast(view, "What never moves is masked already.")


@pytest.mark.parametrize("frame", [NIGHT, SNOW])
def test_hatching_shows_on_dark_and_bright_water(open_frame, server, frame):
    set_mask(server, [55])
    view = open_frame(frame)
    view.page.evaluate(
        "() => import('/static/core/mission.js').then(({ setSetting }) =>"
        " { setSetting('enhance', 0); setSetting('grid', false);"
        " setSetting('suggestions', false); })"
    )
    view.page.mouse.move(1, 1)
    until(lambda: hatched(view, 55) and not hatched(view, 57), lambda: "it alone is not hatched")


def hatched(view, cell):
    """Whether lines with a contrast of 3 go through a patch, and to what lies around it."""
    shot = np.frombuffer(view.page.screenshot(), np.uint8)
    seen = luminance(cv2.imdecode(shot, cv2.IMREAD_COLOR)[..., ::-1])
    (x, y), (beside, below) = (map(round, view.at(one)) for one in (cell, cell + 11))
    y += (below - y) * 2 // 5  # beside the mark in the middle of a patch that is not seen
    lines, ground = seen[y, x - 15 : x + 15], seen[y, beside]
    apart = contrast(lines.max(), lines.min()) > 3
    return apart and contrast(lines, ground).max() > 3


def test_the_overview_shows_the_mask_and_labels_around_it(browse, server):
    set_mask(server, CLOCK)
    page = browse(server, "#/overview/left/20")
    page.wait_for_selector("[data-frame='20'] img")
    page.wait_for_function("() => !document.querySelector('.thumb.loading')")
    thumb = page.locator("[data-frame='20'] .thumb-picture")
    until(lambda: ink(page, 0.85, 0.05) and not ink(page, 0.25, 0.05))
    box = thumb.bounding_box()
    page.keyboard.press("3")
    for part in (0.65, 0.85):
        x, y = box["x"] + part * box["width"], box["y"] + 0.05 * box["height"]
        page.mouse.click(x, y)
    page.mouse.move(x + 1, y)
    page.wait_for_selector("[data-frame='20'] .thumb-picture[title='masked: no view']")
    page.mouse.move(x - 0.6 * box["width"], y)
    page.wait_for_selector("[data-frame='20'] .thumb-picture:not([title])")
    page.wait_for_selector("#save-state[data-state=saved]")
    mine = server.get("/api/labels", camera="left", frames=20, who="anna")["frames"][0]["mine"]
    assert [cell for cell, label in enumerate(mine) if label] == [6]


def ink(page, x, y):
    """Whether something is drawn over a point of a thumbnail, in parts of its width and height."""
    return page.locator("[data-frame='20'] canvas").evaluate(
        "(canvas, [x, y]) => canvas.getContext('2d').getImageData("
        "x * canvas.width, y * canvas.height, 1, 1).data[3] > 0",
        [x, y],
    )
