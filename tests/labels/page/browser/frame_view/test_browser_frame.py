"""The frame view in a real browser: what is painted is what the store holds."""

import itertools
import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from tests.fixtures import draw_tiny_frame
from tests.labels.page.conftest import knows
from tests.waiting import until
from tokt.labels.taxonomy import Taxonomy
from tokt.models.bundle.bundle import bundle_bytes, read_bundle

pytestmark = pytest.mark.xdist_group("browser_frame")  # what they share is made once


SAND = {"who": "anna", "class": "sand"}


@pytest.fixture(scope="module")
def server(page_server, tiny_bundle):
    return page_server("--annotator", "anna", "--model", tiny_bundle)


DEFAULTS = {"filter": "all", "confidence": 0.5, "follow": 2, "selected": ""}


@pytest.fixture(scope="module")
def tab(server, browse_on, frame_page):
    return frame_page(browse_on(server, "#/label/left/1"), server, 1)


@pytest.fixture
def view(tab):
    """A page that tests share; what they set is as at first again."""
    tab.page.evaluate(
        "values => { import('/static/core/mission.js').then(({ setSetting }) =>"
        " Object.entries(values).forEach(([name, value]) => setSetting(name, value))); }",
        DEFAULTS,
    )
    return tab


@pytest.fixture
def fresh(open_frame):
    """A page that nobody used."""
    return open_frame(1)


def test_click_drag_rectangle_row_and_rest_are_stored(view):
    view.open(3)
    view.label("5", 44)
    view.drag(0, 7, 77)  # two long jumps: none of the patches between may be left out
    view.page.keyboard.down("Shift")
    view.press("3")
    view.drag(81, 92)
    view.page.keyboard.up("Shift")
    view.click(99, button="right")
    view.press("4")
    view.page.mouse.click(*view.row_head(5))
    view.saved()
    expected = {44: "subsea_installation", 99: "unsure"}
    expected |= dict.fromkeys(range(8), "subsea_installation")
    expected |= dict.fromkeys(range(17, 78, 10), "subsea_installation")
    expected |= dict.fromkeys((81, 82, 91, 92), "sand")
    expected |= dict.fromkeys(range(50, 60), "reef")
    assert view.stored(3) == expected
    view.press("o")
    view.saved()
    rest = dict.fromkeys(set(range(100)) - set(expected), "ocean")
    assert view.stored(3) == expected | rest
    assert view.text("#status").endswith("done") or "done" in view.text("#status")


def test_a_stroke_is_of_the_frame_on_which_it_began(view):
    view.open(10)
    view.press("5")
    view.page.mouse.move(*view.at(30))
    view.page.mouse.down()
    view.page.mouse.move(*view.at(32))
    view.press("d")
    view.wait(11)
    view.page.mouse.move(*view.at(35))
    view.page.mouse.up()
    assert view.stored(10) == dict.fromkeys((30, 31, 32), "subsea_installation")
    assert view.stored(11) == {}


def test_undo_and_redo_reach_back_over_a_reload(view):
    view.open(5)
    view.label("2", 10)
    view.click(11)
    view.label("e", 10)
    view.press("1")
    view.open(6)
    view.click(20)
    assert view.stored(5) == {11: "other"} and view.stored(6) == {20: "ocean"}
    view.page.reload()
    view.wait(6)
    view.press("Control+z")
    view.shows("#toast", "paint")
    assert view.stored(6) == {}
    view.press("d")
    view.wait(7)
    view.press("Control+z")
    view.wait(5)
    assert "erase" in view.text("#toast") and "frame 5" in view.text("#toast")
    view.press("Control+z", "Control+Shift+z", "Control+y")
    assert view.stored(5) == {11: "other"}
    view.press("Control+z", "Control+z", "Control+z")
    assert view.stored(5) == {}


def test_a_frame_is_labelled_by_keyboard_alone(fresh, server):
    fresh.page.keyboard.type("f8\n")
    fresh.wait(8)
    fresh.press("Escape", "ArrowDown", "ArrowDown", "ArrowRight", "3", "Space")  # row 2, column 2
    fresh.shows("#announcer", "sand: row 1, column 1")
    fresh.press("ArrowRight", "Shift+ArrowRight", "Shift+ArrowDown", "5")
    fresh.shows("#announcer", "subsea_installation: row 1, column 2 and 3 more")
    fresh.press("Escape", "ArrowDown", "ArrowDown", "4", "r")
    fresh.press("ArrowDown", "u", "Space", "m", "o", "m")  # not shown, the model still has its say
    fresh.saved()
    expected = dict.fromkeys({*range(100)} - {*obstacles_said(server, 8)}, "ocean")
    expected |= {11: "sand", 53: "unsure"}
    expected |= dict.fromkeys((12, 13, 22, 23), "subsea_installation")
    expected |= dict.fromkeys(range(40, 50), "reef")
    assert fresh.stored(8) == expected
    fresh.press("n")
    assert "frame 8 " not in fresh.text("#status")
    fresh.press("?")
    overlay = fresh.page.locator("#help")
    assert overlay.is_visible()
    text = overlay.text_content() or ""
    for word in ("subsea_installation", "next frame", "undo", "Alt+click", "raw frame"):
        assert word.lower() in text.lower()
    fresh.press("Escape")
    assert not overlay.is_visible()


def test_keys_of_the_taxonomy_win_and_page_keys_stay_reachable(open_frame, page_server, tmp_path):
    taxonomy = tmp_path / "taxonomy.toml"
    lines = ["format = 1"]
    for name, key, obstacle in (("water", "d", "false"), ("coral", "?", "true")):
        lines += ["[[classes]]", f'name = "{name}"', f'key = "{key}"', f"obstacle = {obstacle}"]
        lines += ['color = "#123456"']
    taxonomy.write_text("\n".join(lines))
    server = page_server("--annotator", "anna", "--taxonomy", taxonomy)
    view = open_frame(4, server)
    view.press("d")
    view.click(3)
    view.press("?")
    view.click(4)
    assert view.stored(4) == {3: "water", 4: "coral"}
    view.press("Alt+d")
    view.wait(5)
    view.press("Alt+?")
    text = view.page.locator("#help").text_content() or ""
    assert "Alt+d" in text and "Alt+?" in text


def test_suggestions_are_labels_only_when_accepted(view, server):
    view.open(14)
    view.page.wait_for_function(
        "() => /of 100 suggested patches/.test(document.querySelector('.model-said').textContent)"
    )
    assert view.stored(14) == {}
    view.label("2", 0)
    view.click_holding("Alt", 1)
    view.saved()
    query = {"who": "anna", "camera": "left", "frames": 14, "suggest": 1}
    [suggested] = server.get("/api/labels", **query)["frames"]
    assert set(view.stored(14)) == {0, 1} and list(suggested["models"]) == ["1"]
    values = suggested["suggestions"]["values"]
    view.press(*">" * 25, "Enter")
    view.saved()
    confident = {cell for cell in range(2, 100) if values[cell] >= 3}
    assert 10 < len(confident) < 90
    assert set(view.stored(14)) == {0, 1} | confident
    assert view.stored(14)[0] == "other"
    view.press("Shift+Enter")
    view.saved()
    confirmed = view.records(14)
    assert len(confirmed) == 100 and {one.source for one in confirmed} == {"human"}
    versions = {one.model_version for one in confirmed if (one.row, one.col) != (0, 0)}
    assert len(versions) == 1 and None not in versions
    view.press("Control+z")
    view.saved()
    assert set(view.stored(14)) == {0, 1} | confident


def test_which_obstacle_is_asked_once_where_several_were_learnt(
    open_frame, page_server, tiny_bundle, tmp_path
):
    content = read_bundle(tiny_bundle).content
    learnt = {"ocean": 500, "sand": 30, "reef": 70}
    several = replace(content, provenance={**content.provenance, "label_counts": learnt})
    (tmp_path / "several.tokt").write_bytes(bundle_bytes(several))
    server = page_server("--annotator", "anna", "--model", tmp_path / "several.tokt")
    view = open_frame(30, server)
    view.page.wait_for_selector("#question[open]")
    answers = view.page.locator("#question button")
    assert [text.split("\n")[0] for text in answers.all_inner_texts()][:1] == ["4"]  # reef's key
    view.press("Escape", "Shift+Enter")
    view.page.wait_for_selector("#question[open]")  # nothing was guessed
    view.saved()
    assert view.stored(30) == {}
    answers.first.click()
    view.page.wait_for_selector("#question:not([open])", state="attached")
    until(lambda: knows(view.page, "settings.obstacle_as === 'reef'"))
    view.press("Shift+Enter")
    view.saved()
    assert {"ocean", "reef"} == set(view.stored(30).values())
    other = open_frame(31, server)  # the mission remembers, not a browser
    assert other.page.locator("#question[open]").count() == 0


def test_suggestions_of_another_model_than_the_page_knows_are_not_shown(fresh):
    """As between the start of a server with another model and the page hearing of it."""

    def another(route):
        answer = route.fetch(max_retries=3)
        text = answer.text()
        assert '"model":"tiny-lbp/1"' in text
        route.fulfill(response=answer, body=text.replace("tiny-lbp/1", "tiny-lbp/2"))

    fresh.page.route("**/api/labels?**", another)
    fresh.open(17)
    fresh.press("Shift+Enter")
    fresh.shows("#toast", "No suggestions to accept here")
    fresh.page.unroute_all(behavior="wait")  # what it fetches ahead is on its way
    assert fresh.stored(17) == {}


def obstacles_said(server, frame):
    """Patches that the model calls an obstacle."""
    query = {"who": "nobody", "camera": "left", "frames": frame, "suggest": 1}
    [labels] = server.get("/api/labels", **query)["frames"]
    is_obstacle = server.get("/api/mission", who="nobody")["model"]["obstacle"]
    found = labels["suggestions"]["classes"]
    return [cell for cell, which in enumerate(found) if is_obstacle[which]]


def test_no_key_for_many_calls_clear_what_the_model_calls_an_obstacle(view, server):
    """Carried, copied, or the rest: only a stroke of one's own contradicts the model."""
    tower = sorted({*obstacles_said(server, 28)} & {*obstacles_said(server, 29)})
    assert len(tower) > 2
    view.open(28)
    view.page.evaluate(
        "() => import('/static/core/mission.js').then(({ setSetting }) => setSetting('follow', 5))"
    )
    view.label("1", *tower)  # wrong, but a person's own
    view.press("o")  # the rest, but for what else is an obstacle
    view.saved()
    assert set(view.stored(28).values()) == {"ocean"}
    view.press("d")
    view.wait(29)
    for keys in (("Shift+Enter",), ("p", "Enter"), ("o",), ("m", "o", "p", "Enter", "m")):
        view.press(*keys)
        view.saved()
        said = {view.stored(29).get(cell) for cell in tower}
        assert said <= {None, "subsea_installation"}, keys
        assert "ocean" in view.stored(29).values()
        view.press("Control+z")
        view.saved()
        assert view.stored(29) == {}
        view.press("Escape")


def test_suggestions_follow_the_frame_before(view):
    view.open(25)
    view.label("4", 0)
    view.click(1, button="right")
    view.saved()
    view.press(*">" * 30, "d")
    view.wait(26)
    x, y = view.at(0)
    for slider, expected in (("5", "reef kept from the frame before"), ("0", "suggests ocean")):
        view.page.evaluate(
            """value => {
              const input = document.querySelector("[data-setting=follow]");
              input.value = value;
              input.dispatchEvent(new Event("input"));
            }""",
            slider,
        )
        view.page.mouse.move(*view.at(55))
        view.page.mouse.move(x, y)
        assert expected in view.text("#status")
        if slider == "5":
            assert "the model says ocean" in view.text("#status")
            view.press("Enter")  # what is carried against the model is never sure
            view.press("Shift+Enter")
            view.saved()
            view.press("Control+z")
            view.saved()
            assert not {0, 1} & set(view.stored(26))
            view.press("Shift+Enter")
            view.saved()
            kept = {one.col: one for one in view.records(26) if one.row == 0}
            assert kept[0].label == "reef" and kept[1].label == "unsure"
            assert kept[0].model_version is None
            view.press("Control+z")
            view.saved()


def test_the_queue_says_why(view):
    view.open(1)
    view.press("q")
    view.page.wait_for_selector(".why")
    assert "frame 1 " not in view.text("#status") and "Why this frame" in view.text("#status")


def test_copies_wait_for_acceptance_and_outlive_a_reload(view):
    view.open(20)
    view.press("5")
    view.drag(33, 53)
    view.saved()
    view.press("d")
    view.wait(21)
    view.press("p")
    view.shows("#toast", "copied")
    view.page.wait_for_url(re.compile("#/label/left/21$"))
    view.page.reload()
    view.wait(21)
    assert view.stored(21) == {}
    view.click_holding("Alt", 43)
    assert view.stored(21) == {43: "subsea_installation"}
    view.press("Escape", "Escape")
    assert "dropped" in view.text("#toast")
    view.press("p")
    view.shows("#toast", "copied")
    view.press("m", "Enter", "m")  # without the suggestions, so that Enter takes the copies only
    assert view.stored(21) == dict.fromkeys((33, 43, 53), "subsea_installation")
    view.press("Control+z", "m", "Enter", "m")  # undone, they are copies again
    view.saved()
    assert view.stored(21) == dict.fromkeys((33, 43, 53), "subsea_installation")


def test_the_address_names_the_frame(view):
    view.open(30)
    view.press("d", "d", "a")
    view.page.wait_for_url(re.compile("#/label/left/31$"))
    view.page.reload()
    view.wait(31)
    view.page.goto(view.page.url.split("#")[0] + "#/label/left/999")
    view.shows("#status", "no frame 999")
    strip = view.page.locator(".timeline")
    strip.focus()
    view.press("Home")
    view.wait(1)
    view.press("End")
    view.wait(40)
    assert strip.get_attribute("aria-valuenow") == "40"


def test_filters_lead_the_steps(view, server):
    view.open(36)
    view.press("o")
    view.saved()
    view.open(1)
    view.page.locator(".filter").select_option("d")
    view.page.locator(".frame-canvas").focus()
    assert "match" in (view.page.locator(".matches").text_content() or "")
    view.press("End")
    view.wait(36)
    view.open(34)
    view.label("3", 7)
    view.saved()
    view.page.locator(".filter").select_option(label="with sand of mine")
    view.page.locator(".frame-canvas").focus()
    view.shows(".matches", f"{len(server.get('/api/frames_with', **SAND)['cameras']['left'])} ")
    view.press("End")
    view.wait(34)
    view.press("Control+z")
    view.shows("#toast", "Undone")
    view.saved()
    assert 34 not in server.get("/api/frames_with", **SAND)["cameras"]["left"]


def test_the_frames_that_the_model_learns_most_from_stay_until_they_are_done(view, server):
    [total] = {server.get("/api/queue")["total"]}
    until(lambda: knows(view.page, f"model.done === {total}"))
    queue = [one["frame"] for one in server.get("/api/queue", who="anna", n=5)["frames"]]
    view.open(1)
    view.page.locator(".filter").select_option("next")
    shown = []
    for frame in sorted(frame for frame in queue if frame > 1):
        view.page.wait_for_timeout(100)
        view.press("d")
        view.wait(frame)
        shown.append(frame)
        view.press("o")  # what is labelled does not leave the list
        view.saved()
    assert len(shown) >= 4


def test_an_unreadable_frame_says_so_and_is_passed(open_frame, own_tiny, page_server):
    (own_tiny.path / "Left" / "tiny_L_2.png").write_bytes(b"no picture")
    server = page_server("--annotator", "anna", mission=own_tiny.path)
    view = open_frame(1, server, allow="422")
    view.press("d")
    view.shows("#status", "cannot be shown")
    view.click(5)
    view.press("d")
    view.wait(3)
    view.click(5)
    assert view.stored(2) == {} and view.stored(3) == {5: "ocean"}


def test_blind_hides_what_others_and_the_model_said(fresh, server):
    server.paint("by-ben", 38, [0, 1], "reef", who="ben")
    fresh.open(38)
    x, y = fresh.at(0)
    fresh.page.mouse.move(x, y)
    fresh.shows("#status", "ben: reef")
    fresh.page.locator("#person").click()
    fresh.page.locator("#person-blind").check()
    fresh.page.get_by_text("Label as this").click()
    fresh.page.wait_for_selector("#blind-badge:visible")
    fresh.wait(38)
    fresh.page.mouse.move(*fresh.at(5))
    fresh.page.mouse.move(x, y)
    assert "ben" not in fresh.text("#status") and "suggests" not in fresh.text("#status")
    fresh.press("S")
    assert fresh.text(".drawer .model") == "Blind: suggestions are hidden."
    server.post("/api/blind", who="anna", blind=False)
    fresh.page.wait_for_selector("#blind-badge", state="hidden")


def test_looking_closer_changes_nothing(fresh):
    fresh.open(33)

    def pressed(name):
        return fresh.page.locator(f"[data-command={name}]").get_attribute("aria-pressed")

    for key, name in (("h", "raw"), ("b", "blink")):
        fresh.press(key)
        assert pressed(name) == "true"
        fresh.press(key)
        assert pressed(name) == "false"
        fresh.page.keyboard.down(key)
        fresh.page.wait_for_timeout(350)
        assert pressed(name) == "true"
        fresh.page.keyboard.up(key)
        assert pressed(name) == "false"
    fresh.press("l", "v", "]", "+", "+", "Control+ArrowLeft", "s")
    assert "one camera" in fresh.text("#toast")
    assert fresh.page.locator("[data-setting=enhance]").input_value() == "70"
    fresh.press("0")
    before = fresh.at(44)
    fresh.page.mouse.move(*before)
    fresh.page.mouse.wheel(0, -600)
    fresh.page.keyboard.down("Space")
    fresh.drag(44, 66)
    fresh.page.keyboard.up("Space")
    assert fresh.stored(33) == {}
    fresh.page.mouse.move(*fresh.at(66))
    fresh.shows("#status", "row 4, column 4")  # what was dragged there


def linear(colours):
    """Linear light of sRGB colours from 0 to 255, of shape (..., 3), R first."""
    parts = np.asarray(colours, float) / 255
    return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)


def luminance(colours):
    return linear(colours) @ (0.2126, 0.7152, 0.0722)


def contrast(one, other):
    """WCAG's contrast of two luminances."""
    return (np.maximum(one, other) + 0.05) / (np.minimum(one, other) + 0.05)


DARK_CLASSES = {"night": "#000000", "navy": "#000080"}
"""A user's classes whose lines nobody would see in the taxonomy's own colours."""


@pytest.fixture
def waters(tmp_path, page_server, open_frame):
    """A page as `open_frame` opens it; its frames are dark, mid and bright water."""
    taxonomy = Taxonomy.load().to_json()["classes"]
    taxonomy += [
        {**taxonomy[1], "name": name, "color": color, "key": key}
        for (name, color), key in zip(DARK_CLASSES.items(), "67", strict=True)
    ]
    lines = ["format = 1"]
    for known in taxonomy:
        lines += ["[[classes]]", *(f"{name} = {json.dumps(of)}" for name, of in known.items())]
    (tmp_path / "taxonomy.toml").write_text("\n".join(lines))
    mission = tmp_path / "tiny"
    mission.mkdir()
    for frame, water in enumerate(((0, 0, 0), (120, 90, 30), (225, 215, 180)), 1):
        cv2.imwrite(str(mission / f"a_{frame}.png"), cv2.add(draw_tiny_frame(33), (*water, 0)))
    options = ["--annotator", "anna", "--taxonomy", tmp_path / "taxonomy.toml"]
    server = page_server(*options, mission=mission)
    kept = [{"name": "tokt.settings", "value": json.dumps({"enhance": 0, "grid": False})}]
    storage = {"cookies": [], "origins": [{"origin": server.url.rstrip("/"), "localStorage": kept}]}
    return lambda: open_frame(1, server, storage_state=storage)


def test_lines_around_labels_show_on_dark_mid_and_bright_water(waters):
    view = waters()
    names = [*Taxonomy.load().names[1:], *DARK_CLASSES, "unsure"]
    cells = {name: 11 + 2 * (at % 4) + 20 * (at // 4) for at, name in enumerate(names)}
    for frame in (1, 2, 3):
        for name, cell in cells.items():
            view.server.paint(f"{frame}-{name}", frame, [cell], name)
        view.open(frame)
        view.shows("#status", f"{len(names)} of 100")
        view.page.wait_for_function(DRAWN)
        shot = np.frombuffer(view.page.screenshot(), np.uint8)
        seen = luminance(cv2.imdecode(shot, cv2.IMREAD_COLOR)[..., ::-1])
        for name, cell in cells.items():
            (x, y), (right, _) = view.at(cell), view.at(cell + 1)
            edge = round((x + right) / 2)
            line, beside = seen[round(y), edge - 6 : edge + 1], seen[round(y), edge - 9]
            assert contrast(line, beside).max() >= 3, (name, frame)
            assert contrast(line, seen[round(y), edge + 3]).max() >= 3, (name, frame)


DRAWN = """() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))
  .then(() => true)"""

BORDERS = """signs => signs.map((one) =>
  getComputedStyle(one).borderTopColor.match(/\\d+/g).map(Number))"""

# Machado, Oliveira and Fernandes (2009): how linear light looks to those without one kind of cone.
EYES = {
    "all cones": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}


def test_colours_of_classes_show_on_any_ground_and_stay_apart(waters):
    """Of a light line with a black rim one shows on any ground: by all grounds there are."""
    shown = waters().page.locator(".painter .sign").evaluate_all(BORDERS)
    names = [*Taxonomy.load().names, *DARK_CLASSES, "unsure"]
    colours = {name: np.array(one) for name, one in zip(names, shown, strict=False)}
    grounds = np.linspace(0, 1, 10_001)
    for name, colour in colours.items():
        best = np.maximum(contrast(luminance(colour), grounds), contrast(0, grounds))
        assert best.min() >= 3, name
    for eyes, cones in EYES.items():
        lab = {}
        for name in colours.keys() - DARK_CLASSES:
            light = np.clip(np.array(cones) @ linear(colours[name]), 0, 1)
            low = light <= 0.0031308
            lab[name] = rgb2lab(np.where(low, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055))
        for one, other in itertools.combinations(lab, 2):
            assert deltaE_ciede2000(lab[one], lab[other]) > 9, (eyes, one, other)
