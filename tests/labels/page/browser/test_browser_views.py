"""Review sheet, overview and agreement in a real browser, checked in the store's file."""

import itertools
import json
import re

import pytest

from tests.waiting import until
from tokt.features.frames.grid import Grid
from tokt.labels.agreement import agreement
from tokt.labels.formats.audit_csv import Audit, AuditedPatch, write_audit
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import Taxonomy

GRID = Grid(10, 10, 360)
TIME = "2016-04-20T10:00:00Z"
TOWER = "subsea_installation"
ANNAS, BENS = range(1, 21), range(5, 9)
PLANTED = {(5, 0): "sand", (5, 1): "sand", (6, 50): "reef", (7, 99): "reef", (8, 3): "unsure"}
"""Patches (frame, cell) of ocean that ben says something else of."""
SURE = len(PLANTED) - 1


def record(frame, cell, label, who):
    row, col = divmod(cell, GRID.cols)
    return LabelRecord("tiny", "left", frame, GRID, row, col, label, who, TIME)


@pytest.fixture(scope="module")
def server(page_server, tiny_truth, tiny_bundle, tmp_path_factory):
    """Anna labelled half the tiny mission, ben four of her frames; there is a model."""
    workspace = tmp_path_factory.mktemp("views") / ".tokt"
    workspace.mkdir()
    rows = [(frame, 10 * row + col, label) for _, _, frame, row, col, label in tiny_truth.labels()]
    truth = {(frame, cell): label for frame, cell, label in rows}
    records = [record(*at, label, "anna") for at, label in truth.items() if at[0] in ANNAS]
    records += [
        record(*at, PLANTED.get(at, label), "ben") for at, label in truth.items() if at[0] in BENS
    ]
    with LabelStore(workspace / "labels.db") as store:
        store.add(records)
    return page_server("--annotator", "anna", "--model", tiny_bundle, workspace=workspace)


@pytest.fixture
def open_page(browse, server):
    """Open a place of the page, and wait for something that is there when it can be used."""

    def start(place, ready, **options):
        page = browse(server, place, **options)
        page.wait_for_selector(ready)
        return page

    return start


@pytest.fixture
def changes(server):
    """What a person's labels have become since the test began: {(frame, cell): label}."""
    before = in_store(server)

    def since(who="anna"):
        now = in_store(server)
        keys = {at[1:] for at in before | now if at[0] == who}
        return {
            at: now.get((who, *at)) for at in keys if now.get((who, *at)) != before.get((who, *at))
        }

    return since


PLACES = {
    "#/label/left/1": ".status",
    "#/overview/left/1": ".thumb",
    "#/sheet/unsure": ".tile",
    "#/agreement/anna/ben": "table",
    "#/audit": "#view > *",
    "#/files": ".classes",
}


def test_no_view_keeps_people_out(open_page, server):
    """As far as axe-core can tell; what only a person can judge is not in it."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page = open_page("", ".status", allow="401|favicon")
    for place, ready in PLACES.items():
        page.goto(page.url.partition("#")[0] + place)
        page.wait_for_selector(ready)
        check_access(axe, page, place)
    for opens in ("#help-button", "#person"):
        page.click(opens)
        check_access(axe, page, opens)
        page.keyboard.press("Escape")
    page.context.clear_cookies()
    assert page.goto(server.url.partition("?")[0]).status == 401
    check_access(axe, page, "token")
    page.goto(server.url)


def check_access(axe, page, place):
    rules = axe.run(page, options={"resultTypes": ["violations"]}).response["violations"]
    found = [(rule["impact"], rule["id"], rule["nodes"][0]["html"]) for rule in rules]
    assert [one for one in found if one[0] in ("serious", "critical")] == [], place
    assert "page-has-heading-one" not in [one[1] for one in found], place


def in_store(server):
    with LabelStore(server.workspace / "labels.db") as store:
        return {
            (one.annotator, one.frame, one.row * GRID.cols + one.col): one.label
            for one in store.current("tiny", grid=GRID)
        }


def saved(page):
    """Wait until the page says that all is saved."""
    page.wait_for_function("() => document.querySelector('#save-state').dataset.state === 'saved'")


def undo(page):
    page.keyboard.press("Control+z")
    page.wait_for_function("() => document.querySelector('#toast').textContent.includes('Undone')")
    saved(page)


def toast(page, text):
    """Wait until the page says this."""
    page.wait_for_function(
        "text => document.querySelector('#toast').textContent.includes(text)", arg=text
    )


def patches(page, which=""):
    """The tiles shown that `which` (CSS) chooses."""
    names = page.locator(f".tile{which}").evaluate_all(
        "tiles => tiles.map((tile) => tile.getAttribute('aria-label'))"
    )
    return [patch_of(name) for name in names]


def selected(page):
    return patches(page, "[aria-selected=true]")


def patch_of(name):
    found = re.match(r"left (\d+), row (\d+), column (\d+)", name)
    assert found, name
    frame, row, col = map(int, found.groups())
    return frame, row * GRID.cols + col


def back_from_its_frame(page):
    """Open the frame of the patch under the cursor and come back; which patch it is then."""
    page.keyboard.press("Enter")
    page.wait_for_url("**/#/label/left/**")
    page.go_back()
    page.wait_for_selector(".tile.at-cursor")
    return patches(page, ".at-cursor")[0]


def test_patches_relabelled_on_the_sheet_are_in_the_store_and_undone_together(open_page, changes):
    page = open_page(f"#/sheet/{TOWER}", ".tile")
    tiles = page.locator(".tile")
    page.keyboard.press("4")
    toast(page, "Select patches first")
    tiles.nth(1).click()
    tiles.nth(4).click(modifiers=["Shift"])
    tiles.nth(7).click()
    tiles.nth(2).click()
    chosen = selected(page)
    assert len(chosen) == 4
    page.keyboard.press("4")
    toast(page, "4 patches are now reef; Ctrl+Z undoes.")
    saved(page)
    assert changes() == dict.fromkeys(chosen, "reef")
    assert tiles.nth(7).locator(".tile-caption").inner_text().split() == ["4", "reef"]
    assert page.locator(".tab", has_text="reef").locator(".count").inner_text() == "4"
    undo(page)
    assert changes() == {}
    assert tiles.nth(7).locator(".tile-caption").inner_text() == ""
    page.get_by_role("link", name="Go there").click()
    page.wait_for_url("**/#/label/left/*")
    assert int(page.url.rsplit("/", 1)[1]) in {frame for frame, _ in chosen}


def test_a_new_order_does_not_move_what_somebody_selects(open_page, changes):
    page = open_page("#/overview/left/1", ".thumb")
    asked = []

    def order(route):
        """Not ready, then ready, then in another order, which comes late."""
        answer = route.fetch(max_retries=3)
        value = answer.json()
        asked.append((route, {**value, "patches": value["patches"][::-1]}))
        if len(asked) < 3:
            route.fulfill(json={**value, "ready": len(asked) == 2})

    page.route("**/api/sheet?**", order)
    page.goto(page.url.split("#")[0] + f"#/sheet/{TOWER}")
    page.wait_for_selector(".tile")
    for _ in range(300):
        if len(asked) < 3:
            page.wait_for_timeout(100)
    assert len(asked) == 3
    page.locator(".tile").nth(2).click()
    chosen = selected(page)
    route, answer = asked[2]
    route.fulfill(json=answer)
    page.wait_for_function(
        "() => document.querySelector('.sheet-words').textContent.includes('press r')"
    )
    assert len(chosen) == 1 and selected(page) == chosen
    page.keyboard.press("4")
    toast(page, "1 patch is now reef")
    saved(page)
    assert changes() == {chosen[0]: "reef"}
    undo(page)


def test_one_key_accepts_all_frames_shown_but_those_left_out_and_goes_on(
    open_page, server, changes
):
    page = open_page("#/overview/left/21", ".thumb:not(.loading)")
    # What is kept from the frame before is not the model's and carries no version.
    page.evaluate(
        "() => localStorage.setItem("
        "'tokt.settings', JSON.stringify({follow: 0, overviewColumns: 5}))"
    )
    page.reload()
    page.wait_for_selector(".thumb:not(.loading)")
    page.keyboard.press("+")
    page.wait_for_function("() => document.querySelectorAll('.thumb').length === 8")
    page.wait_for_function("() => !document.querySelector('.thumb.loading')")
    page.keyboard.press("x")
    for key in ("4", "ArrowRight", "Control+ArrowUp", "Control+ArrowUp", "Space"):
        page.keyboard.press(key)
    page.wait_for_selector(".thumb.left-out")
    page.keyboard.press("Shift+Enter")
    page.wait_for_url("**/#/overview/left/29")
    saved(page)
    changed = changes()
    painted = (22, 45)
    assert changed[painted] == "reef"
    assert set(changed) == {(frame, cell) for frame in range(22, 29) for cell in range(100)}
    with LabelStore(server.workspace / "labels.db") as store:
        versions = {
            (one.frame, one.row * GRID.cols + one.col): one.model_version
            for one in store.current("tiny", grid=GRID)
            if one.annotator == "anna" and one.frame > max(ANNAS)
        }
    assert versions.pop(painted) is None
    assert set(versions.values()) == {"tiny-lbp/1"}
    undo(page)
    toast(page, "Undone: accept, 699 patches, left frame 22 and 6 more.")
    page.wait_for_url("**/#/overview/left/22")
    page.wait_for_selector(".thumb[aria-selected=true] .thumb-number:text-is('22')")
    assert changes() == {painted: "reef"}
    undo(page)
    assert changes() == {}


def test_frames_left_out_stay_so_and_what_nobody_sees_is_not_labelled(open_page, changes):
    page = open_page("#/overview/left/38", ".thumb:not(.loading)", allow="422|Failed to load")
    broken = {"status": 422, "json": {"error": "no picture"}}
    page.route("**/api/thumb/left/39?**", lambda route: route.fulfill(**broken))
    page.keyboard.press("x")
    page.keyboard.press("]")
    page.wait_for_selector(".thumb-picture.unreadable")
    page.wait_for_function("() => !document.querySelector('.thumb.loading')")
    page.set_viewport_size({"width": 1100, "height": 700})
    page.wait_for_timeout(200)
    # The server is heard anew, as after it was started anew or the tab was hidden.
    page.evaluate("() => { import('/static/core/mission.js').then((one) => one.loadMission()); }")
    page.wait_for_timeout(200)
    page.wait_for_function("() => !document.querySelector('.thumb.loading')")
    assert page.locator(".thumb.left-out .thumb-number").all_inner_texts() == ["38"]
    page.locator(".thumb-picture").nth(1).click()
    page.keyboard.press("o")
    toast(page, "open: the model sees an obstacle there")
    saved(page)
    labelled = changes()
    assert 90 < len(labelled) < 100 and {frame for frame, _ in labelled} == {40}
    undo(page)
    assert changes() == {}


def test_strokes_and_rectangles_in_thumbnails_paint_as_one_action_each(open_page, changes):
    page = open_page("#/overview/left/31", ".thumb:not(.loading)")
    page.keyboard.press("3")
    here = [page.locator(".thumb canvas").nth(index).bounding_box() for index in (0, 1, 2)]

    def drag(first, last, button="left"):
        for step, (thumb, cell) in enumerate((first, last)):
            box = here[thumb]
            assert box is not None
            row, col = divmod(cell, 10)
            x, y = box["x"] + box["width"] * (col + 0.5) / 10, box["y"] + 12.5 * (row + 0.5)
            page.mouse.move(x, y, steps=8)
            if step == 0:
                page.mouse.down(button=button)
        page.mouse.up(button=button)

    drag((0, 38), (1, 31))
    drag((2, 0), (2, 0), button="right")
    page.keyboard.down("Shift")
    drag((2, 11), (2, 22))
    page.keyboard.up("Shift")
    saved(page)
    stroke = dict.fromkeys([(31, 38), (31, 39), (32, 30), (32, 31)], "sand")
    rectangle = dict.fromkeys([(33, 11), (33, 12), (33, 21), (33, 22)], "sand")
    assert changes() == {**stroke, (33, 0): "unsure", **rectangle}
    page.keyboard.press("ArrowRight")
    undo(page)
    page.wait_for_selector(".thumb[aria-selected=true] .thumb-number:text-is('33')")
    assert page.url.endswith("#/overview/left/31")
    assert changes() == {**stroke, (33, 0): "unsure"}
    for left in (stroke, {}):
        undo(page)
        assert changes() == left


QUIET = """() => new Promise((resolve) => {
  const list = document.querySelector(".thumbs");
  new MutationObserver(() => resolve(false)).observe(list, { childList: true });
  setTimeout(() => resolve(!list.querySelector(".loading")), 500);
})"""


def test_the_overview_comes_to_rest_also_where_its_words_take_two_lines(open_page):
    page = open_page("#/overview/left/18", ".thumb")
    page.wait_for_selector("text=suggestions sure")
    for width in (600, 640, 680):
        page.set_viewport_size({"width": width, "height": 700})
        until(lambda: page.evaluate(QUIET))
        assert "suggestions sure" in page.inner_text(".overview-words")


def test_what_is_said_does_not_cover_the_menu(open_page):
    page = open_page("#/overview/left/1", ".thumb")
    page.keyboard.press("PageUp")
    toast(page, "This is the first page.")
    header, box = (page.locator(name).bounding_box() for name in ("#header", "#toast"))
    assert box["y"] >= header["y"] + header["height"]
    assert "left frames 1 to " in page.inner_text(".overview-range")


def test_a_double_click_on_a_picture_opens_the_frame_and_writes_nothing(open_page, server, changes):
    page = open_page("#/overview/left/31", ".thumb:not(.loading)")
    before = events(server)
    picture = page.locator(".thumb canvas").nth(2)
    spot = {"x": 40, "y": 30}
    picture.click(position=spot)  # nobody chose a class: the first one means clear
    toast(page, "Choose a class first, by its key: 1 ocean, 2 other,")
    page.keyboard.press("3")
    picture.dblclick(position=spot)
    page.wait_for_url("**/#/label/left/33")
    toast(page, "nothing was painted")
    page.go_back()
    page.wait_for_selector(".thumb:not(.loading)")
    saved(page)
    page.wait_for_timeout(700)  # longer than a click waits for a second one
    saved(page)
    assert events(server) == before and changes() == {}
    picture.click(position=spot)
    toast(page, "1 patch is now sand, left frame 33; Ctrl+Z undoes.")
    saved(page)
    assert list(changes().values()) == ["sand"]
    undo(page)


def events(server):
    """How many events the store holds, those that were taken back too."""
    with LabelStore(server.workspace / "labels.db") as store:
        return store.last_event()


def expected_kappa(server):
    with LabelStore(server.workspace / "labels.db") as store:
        records = store.current("tiny", grid=GRID)
    of = {who: [one for one in records if one.annotator == who] for who in ("anna", "ben")}
    kappa = agreement(of["anna"], of["ben"], Taxonomy.load()).kappa
    assert kappa is not None and kappa < 1
    return f"{kappa:.3f}"


def settled(server):
    with LabelStore(server.workspace / "labels.db") as store:
        return {
            (one.frame, one.row * GRID.cols + one.col): (one.label, one.annotator)
            for one in store.settled("tiny", grid=GRID)
        }


def test_conflicts_are_settled_both_opinions_stay_and_it_can_be_taken_back(
    open_page, server, changes
):
    page = open_page("#/agreement/anna/ben", ".conflicts .tile")
    assert page.locator(".kappa strong").inner_text() == expected_kappa(server)
    assert page.locator(".conflicts .tile").count() == SURE
    page.keyboard.press("4")
    toast(page, "Select patches first: click them, or use the arrow keys.")
    page.keyboard.press("e")
    assert set(patches(page)) == set(PLANTED)
    page.get_by_role("button", name="2 patches anna: ocean, ben: sand").click()
    assert set(patches(page)) == {(5, 0), (5, 1)}
    page.keyboard.press("Control+a")
    page.keyboard.press("3")
    toast(page, "2 patches are settled as sand")
    saved(page)
    assert settled(server) == dict.fromkeys([(5, 0), (5, 1)], ("sand", "anna"))
    assert changes("anna") == changes("ben") == {}
    page.keyboard.press("Home")
    assert back_from_its_frame(page) == (5, 0)
    page.keyboard.press("Delete")
    saved(page)
    assert list(settled(server)) == [(5, 1)]
    undo(page)
    assert len(settled(server)) == 2
    undo(page)
    assert settled(server) == {}


def test_audited_labels_are_confirmed_or_relabelled_by_a_person_only(open_page, server, changes):
    doubts = [
        AuditedPatch(*place, "ocean", "reef", margin, "a model takes it for obstacle by 2")
        for place, margin in [
            (("tiny", "left", 9, 0, 0), -3.0),
            (("tiny", "left", 10, 9, 9), -2.0),
            (("other_dive", "left", 9, 0, 1), -1.5),
            (("tiny", "left", 30, 0, 3), -1.0),
            (("tiny", "left", 31, 0, 3), -0.5),
        ]
    ]
    write_audit(server.workspace, Audit("tiny", "dataset tiny", GRID, "a rule.", tuple(doubts)))
    (server.workspace / "audits" / "broken.json").write_text("{", "utf-8")
    listed = {one["name"]: one for one in server.get("/api/audits")["audits"]}
    assert listed["tiny"]["patches"] == 4
    assert "broken.json is damaged; audit again" in listed["broken"]["fault"]
    assert server.request("GET", "/api/audit?name=../labels").status == 404

    server.paint("a-31", 31, [3], "reef", kind="accept")  # nobody looked at this patch
    server.paint("b-9", 9, [0], "ocean", who="ben", source="settled")  # before the audit
    before = {(9, 0): ("ocean", "ben")}
    page = open_page("#/audit/tiny", ".tile")
    assert patches(page) == [(9, 0), (10, 99), (30, 3), (31, 3)]
    server.post("/api/undo", key="u-31", who="anna", time=TIME, target="a-31")
    for key in ("y", "n", "3", "Delete"):
        page.keyboard.press(key)
        toast(page, "Select patches first")
    assert changes() == {} and settled(server) == before
    page.keyboard.press("Home")
    page.keyboard.press("y")  # the label is right
    page.keyboard.press("n")  # the suggestion is
    page.keyboard.press("3")  # neither; nobody has labelled this one
    toast(page, "1 patch is decided; Ctrl+Z undoes.")
    saved(page)
    assert changes() == {(10, 99): "reef"}
    assert settled(server) == {(9, 0): ("ocean", "anna"), (30, 3): ("sand", "anna")}
    page.keyboard.press("ArrowLeft")  # decided by now, and the same when one comes back
    assert back_from_its_frame(page) == (30, 3)
    page.get_by_role("button", name="decided 3").wait_for()
    page.reload()
    page.wait_for_selector(".tile")
    assert patches(page) == [(31, 3)]
    for _ in range(3):
        undo(page)
    page.get_by_role("button", name="decided 0").wait_for()
    assert changes() == {} and list(settled(server)) == list(before)


def test_a_second_labelling_is_blind_and_by_another_person(open_page, server):
    page = open_page("#/agreement/anna/ben", ".conflicts .tile")
    page.keyboard.press("b")
    page.select_option("#blind-of", "ben")
    page.fill("#blind-who", "ben")
    page.keyboard.press("Enter")
    toast(page, "another person's name")
    page.fill("#blind-who", "carl")
    requests = []
    page.on("request", lambda request: "/api/" in request.url and requests.append(request))
    page.keyboard.press("Enter")
    page.wait_for_url("**/#/label/left/5")
    page.goto(page.url.partition("#")[0] + "#/overview/left/1")
    page.wait_for_function(
        "() => [...document.querySelectorAll('.thumb-number')].map((one) => one.textContent)"
        ".join() === '5,6,7,8' && !document.querySelector('.thumb.loading')"
    )
    # It may be drawn once more after the pictures have come.
    page.wait_for_selector(".overview button.main[aria-disabled='true']")
    page.keyboard.press("o")
    toast(page, "now ocean")
    saved(page)
    page.goto(page.url.partition("#")[0] + "#/agreement")
    page.wait_for_selector("text=4 of 4 are done")
    # What the page asked for before carl began is anna's to see, and he is never shown it.
    blind = list(itertools.dropwhile(lambda request: "who=carl" not in request.url, requests))
    told = [request for request in blind if "/api/labels" in request.url]
    assert told and all("who=carl" in request.url for request in told)
    for request in told:
        for frame in request.response().json()["frames"]:
            assert not frame["others"] and not frame["suggestions"]
            assert set(frame["mine"]) <= {None, "ocean"} and not any(frame["settled"])
    assert not any("/api/agreement" in request.url for request in blind)
    page.get_by_role("button", name="End blind labelling and compare").click()
    page.wait_for_selector(".kappa")
    assert "carl: 400" in page.locator("dt:text('Of these blind') + dd").inner_text()


def test_what_cannot_be_shown_is_said_in_a_sentence(browse, page_server):
    lonely = page_server("--annotator", "anna")
    page = browse(lonely, "#/agreement")
    page.wait_for_selector("text=Only anna has worked on this mission so far")
    page.goto(page.url.partition("#")[0] + "#/sheet/sand")
    page.wait_for_selector(".tile-scroller[data-empty='You have labelled no patch sand yet.']")
    page.goto(page.url.partition("#")[0] + "#/overview/left/1")
    page.wait_for_selector("text=No model yet: paint; Settings say more.")
    page.wait_for_function("() => !document.querySelector('.thumb.loading')")
    page.keyboard.press("Enter")
    toast(page, "Nothing to accept here.")


UNREADABLE = """() => [...document.querySelectorAll("body *")].filter((one) => {
  const words = [...one.childNodes].some((child) => child.nodeType === 3 && child.data.trim());
  const shown = one.checkVisibility({ visibilityProperty: true }) && !one.closest(".unseen");
  if (!shown || !(words || one.matches("input, select"))) return false;
  const { fontSize, overflowX } = getComputedStyle(one);
  const cut = overflowX !== "visible" && one.scrollWidth > one.clientWidth + 1;
  return parseFloat(fontSize) < 14 || cut || one.getBoundingClientRect().right > innerWidth + 1;
}).map((one) => `${one.tagName}.${one.className}: ${one.textContent}`)"""


def test_text_is_large_and_whole_in_large_and_small_windows(open_page):
    page = open_page("#/label/left/25", ".toolbar")
    page.keyboard.press("S")  # from here on the drawer is open
    page.wait_for_selector(".drawer >> text=suggested patches sure")
    for place, ready in (
        ("#/label/left/25", ".toolbar"),
        ("#/overview/left/1", ".thumb"),
        ("#/sheet", ".tile"),
        ("#/agreement", ".conflicts .tile"),
    ):
        page.goto(page.url.partition("#")[0] + place)
        page.wait_for_selector(ready)
        for width, height in ((1280, 720), (1024, 640), (640, 360)):  # the last: 200 % of the first
            page.set_viewport_size({"width": width, "height": height})
            assert page.evaluate(UNREADABLE) == [], (place, width)


def test_a_frame_fits_again_when_a_small_window_grows(open_page):
    page = open_page("#/label/left/25", ".frame-canvas")
    for width, height in ((1400, 850), (640, 700), (1400, 850)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(200)  # what is drawn anew may not make room for itself
        page.wait_for_function(
            "() => document.querySelector('.frame-canvas').clientHeight"
            " === document.querySelector('.stage').clientHeight"
        )


def test_a_confirmed_finding_becomes_labels(browse, page_server, tmp_path):
    found = [
        {"label": "reef", "first_frame": 30, "last_frame": 40, "best_frame": frame,
         "along_m": 5.0, "mission": "tiny", "grid": str(GRID), "patches": patches}
        for frame, patches in ((35, [3, 4]), (36, [0, 1]))
    ]  # fmt: skip
    features = [{"type": "Feature", "geometry": None, "properties": each} for each in found]
    value = {"type": "FeatureCollection", "tokt_findings": 1, "features": features}
    (tmp_path / "found.geojson").write_text(json.dumps(value), "utf-8")
    own = page_server("--annotator", "anna", "--findings", tmp_path / "found.geojson")
    page = browse(own)  # the address that is printed shows them
    page.wait_for_selector(".tile")
    held = []  # a person may be faster than the server tells of the labels
    page.route("**/api/labels?*", lambda route: held.append(route))
    page.reload()
    page.wait_for_selector(".tile")
    page.keyboard.press("Home")
    page.keyboard.press("y")  # the whole finding, not one patch of it
    toast(page, "2 patches are decided")
    saved(page)
    first = {("anna", 35, 3): "reef", ("anna", 35, 4): "reef"}
    assert in_store(own) == first
    page.get_by_role("button", name="decided 2").wait_for()
    page.keyboard.press("3")  # the next one is sand
    saved(page)
    page.unroute("**/api/labels?*")  # which lets those go on that are held
    assert in_store(own) == {**first, ("anna", 36, 0): "sand", ("anna", 36, 1): "sand"}
    undo(page)
    undo(page)
    page.get_by_role("button", name="open 4").wait_for()
    assert in_store(own) == {}
