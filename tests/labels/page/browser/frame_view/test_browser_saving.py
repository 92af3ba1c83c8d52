"""Nothing a person did is lost or counted twice: crashes, no server, two tabs, a full disk."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

pytestmark = pytest.mark.xdist_group("browser_saving")  # what they share is made once

if TYPE_CHECKING:
    from playwright.sync_api import Page


def events(server: Any, frame: int) -> int:
    """How many events of a frame the store holds."""
    with sqlite3.connect(server.workspace / "labels.db") as connection:
        query = "SELECT count(*) FROM events WHERE frame = ?"
        return int(connection.execute(query, (frame,)).fetchone()[0])


@pytest.fixture(scope="module")
def server(page_server: Callable[..., Any]) -> Any:
    return page_server("--annotator", "anna")


def test_a_server_killed_in_the_middle_of_a_drag_loses_nothing(
    server: Any,
    browse: Callable[..., Page],
    offline_errors: str,
    stored: Callable[..., Any],
    frame_page: Any,
) -> None:
    view = frame_page(browse(server, "#/label/left/2", allow=offline_errors), 2)
    view.press("5")
    view.click(90)
    view.state("saved")
    view.page.mouse.move(*view.at(0))
    view.page.mouse.down()
    view.page.mouse.move(*view.at(4))
    server.kill()
    view.page.mouse.move(*view.at(9))
    view.page.mouse.up()
    view.state("offline")
    assert "1 waiting" in view.text("#save-state")
    link = view.page.locator("#views a")
    link.nth(1).click()  # a view whose module may not be there yet
    link.nth(0).click()
    view.wait(2)
    server.start()
    view.state("saved")
    link.nth(1).click()
    view.page.wait_for_selector(".thumb:not(.loading)")
    assert stored(server, 2) == dict.fromkeys([*range(10), 90], "subsea_installation")
    assert events(server, 2) == 11


def test_actions_of_a_closed_tab_are_replayed_in_order_and_once(
    server: Any,
    browse: Callable[..., Page],
    offline_errors: str,
    stored: Callable[..., Any],
    frame_page: Any,
) -> None:
    view = frame_page(browse(server, "#/label/left/4", allow=offline_errors), 4)
    view.press("d")
    view.wait(5)
    server.kill()
    view.press("1")
    view.click(0, 1, 2)
    view.press("3")
    view.click(1)
    view.press("e")
    view.click(2)
    view.press("a")
    view.wait(4)
    view.press("2")
    view.click(7, 8)
    view.press("Control+z")
    view.shows("#toast", "Undone: paint, 1 patch, left frame 4")
    view.state("offline")
    assert "8 waiting" in view.text("#save-state")
    assert not view.page.evaluate(
        "() => { const e = new Event('beforeunload', {cancelable: true});"
        " dispatchEvent(e); return e.defaultPrevented; }"
    )
    context = view.page.context
    view.page.close()
    server.start()
    again = frame_page(browse(server, "#/label/left/5", context=context), 5)
    again.state("saved")
    assert stored(server, 5) == {0: "ocean", 1: "sand"}
    assert stored(server, 4) == {7: "other"}
    assert events(server, 5) == 5 and events(server, 4) == 3
    again.page.reload()
    again.wait(5)
    again.state("saved")
    assert events(server, 5) == 5
    again.press("Control+Shift+z")
    again.shows("#toast", "Done again")
    again.state("saved")
    assert stored(server, 4) == {7: "other", 8: "other"}


def test_two_tabs_see_each_other_and_a_conflict_is_listed(
    server: Any, browse: Callable[..., Page], stored: Callable[..., Any], frame_page: Any
) -> None:
    one = frame_page(browse(server, "#/label/left/10"), 10)
    two = frame_page(browse(server, "#/label/left/10", context=one.page.context), 10)
    one.press("3")
    one.click(12)
    two.shows("#status", "1 of 100")
    # What tab two says meanwhile is on its way: here, held back until the other one has spoken.
    held: list[Any] = []
    two.page.route("**/api/actions", lambda route: held.append(route))
    two.press("1")
    two.click(12)
    two.state("saving")
    one.press("4")
    one.click(12)
    one.state("saved")
    held[0].continue_()
    two.page.unroute("**/api/actions")
    two.shows("#notices", "there is now “reef”")
    assert stored(server, 10) == {12: "reef"}
    two.page.get_by_text("Use mine").click()
    two.state("saved")
    two.page.wait_for_selector("#notices", state="hidden")
    assert stored(server, 10) == {12: "ocean"}
    one.point(12)
    one.shows("#status", "row 1, column 2: ocean")


def test_somebody_elses_labels_show_and_stay(
    server: Any, browse: Callable[..., Page], stored: Callable[..., Any], frame_page: Any
) -> None:
    view = frame_page(browse(server, "#/label/left/12"), 12)
    view.press("1")
    view.click(5)
    view.point(5)
    server.paint("ben-12", 12, [5], "reef", who="ben")
    view.shows("#status", "ben: reef, disagreement")
    view.press("e")
    view.click(5)
    view.state("saved")
    assert stored(server, 12) == {} and stored(server, 12, "ben") == {5: "reef"}


def test_an_answer_from_before_a_change_does_not_hide_it(
    server: Any, browse: Callable[..., Page], frame_page: Any
) -> None:
    view = frame_page(browse(server, "#/label/left/30"), 30)
    held: list[Any] = []
    holding = True

    def hold(route: Any) -> None:
        if holding:
            held.append(route)
        else:
            route.continue_()

    view.page.wait_for_timeout(300)  # what is fetched ahead is there
    view.page.route("**/api/labels?**", hold)
    with view.page.expect_request("**/api/labels?**"):
        view.press("End")
    view.page.wait_for_timeout(200)  # and what else it asks for
    older = [(route, route.fetch(max_retries=3)) for route in held]
    server.paint("ben-40", 40, [5], "reef", who="ben")
    view.page.wait_for_timeout(700)  # the event is heard while the older answer is on its way
    holding = False
    for route, answer in older:
        route.fulfill(response=answer)
    for route in held[len(older) :]:
        route.continue_()
    view.wait(40)
    view.point(5)
    view.shows("#status", "ben: reef")


def test_only_the_person_says_who_works_here_and_blind_holds_without_a_server(
    server: Any,
    page_server: Callable[..., Any],
    browse: Callable[..., Page],
    offline_errors: str,
    stored: Callable[..., Any],
    frame_page: Any,
) -> None:
    server.paint("ben-33", 33, [5], "reef", who="ben")
    view = frame_page(browse(server, "#/label/left/33", allow=offline_errors), 33)
    view.point(5)
    view.shows("#status", "ben: reef")
    server.kill()
    view.state("offline")
    view.page.locator("#person").click()
    view.page.locator("#person-name").fill("carl")
    view.page.locator("#person-blind").check()
    view.page.get_by_text("Work as this").click()
    view.shows("#toast", "Not loaded anew")
    assert view.text("#person") == "carl" and "ben" not in view.text("#status")
    mine, server.arguments = server.arguments, ("--annotator", "ben")
    server.start()
    view.wait(33)
    view.state("saved")
    assert view.text("#person") == "carl" and view.page.locator("#blind-badge").is_visible()
    view.point(5)
    assert "ben" not in view.text("#status")
    view.press("3")
    view.click(6)
    view.state("saved")
    assert stored(server, 33, "carl") == {6: "sand"}
    assert stored(server, 33, "ben") == {5: "reef"} and stored(server, 33) == {}
    view.page.close()
    server.kill()
    server.arguments = mine
    server.start()


def test_a_refused_action_is_set_aside_and_later_ones_go_on(
    server: Any, browse: Callable[..., Page], stored: Callable[..., Any], frame_page: Any
) -> None:
    view = frame_page(browse(server, "#/label/left/15", allow="400"), 15)

    def spoil(route: Any) -> None:
        route.continue_(post_data=route.request.post_data.replace('"sand"', '"no such class"'))

    view.page.route("**/api/actions", spoil)
    view.press("3")
    view.click(20)
    view.shows("#notices", "The server refused paint (1 patch on left frame 15)")
    view.press("4")
    view.click(21)
    view.state("saved")
    assert stored(server, 15) == {21: "reef"}
    view.page.reload()
    view.wait(15)
    view.shows("#notices", "The server refused")
    view.page.get_by_text("Discard").click()
    view.page.wait_for_selector("#notices", state="hidden")


def test_a_full_disk_is_said_and_nothing_pretends_to_be_saved(
    server: Any, browse: Callable[..., Page], stored: Callable[..., Any], frame_page: Any
) -> None:
    view = frame_page(browse(server, "#/label/left/17", allow="507"), 17)
    full = {"status": 507, "json": {"error": "label store labels.db: database or disk is full"}}
    view.page.route("**/api/actions", lambda route: route.fulfill(**full))
    view.press("3")
    view.click(30)
    view.state("refused")
    view.shows("#notices", "database or disk is full")
    assert "1 waiting" in view.text("#save-state") and stored(server, 17) == {}
    view.page.unroute("**/api/actions")
    view.page.locator("#try-now").click()
    view.state("saved")
    assert stored(server, 17) == {30: "sand"}


def test_without_storage_nothing_is_taken_while_the_server_is_away(
    server: Any,
    browse: Callable[..., Page],
    offline_errors: str,
    stored: Callable[..., Any],
    frame_page: Any,
) -> None:
    view = frame_page(browse(server, "#/label/left/19", allow=offline_errors), 19)
    view.page.evaluate("() => { Storage.prototype.setItem = () => { throw new Error('full') } }")
    view.press("3")
    view.click(40)
    view.state("saved")
    server.kill()
    view.state("offline")
    view.click(41)
    view.shows("#toast", "cannot keep actions")
    server.start()
    view.state("saved")
    assert stored(server, 19) == {40: "sand"}


def test_another_mission_on_the_same_port_gets_none_of_it(
    server: Any,
    own_tiny: Any,
    browse: Callable[..., Page],
    offline_errors: str,
    stored: Callable[..., Any],
    frame_page: Any,
) -> None:
    other = own_tiny.path.rename(own_tiny.path.with_name("elsewhere"))
    view = frame_page(browse(server, "#/label/left/22", allow=f"{offline_errors}|421"), 22)
    server.kill()
    view.press("3")
    view.click(50)
    view.state("offline")
    mine, server.mission = server.mission, other
    server.start()
    view.state("refused")
    view.shows("#notices", "elsewhere")
    view.press("End")  # its picture would be the other mission's
    view.shows("#status", "cannot be shown")
    view.click(51)
    assert "1 waiting" in view.text("#save-state")
    context = view.page.context
    view.page.close()
    stranger = frame_page(browse(server, "#/label/left/1", context=context), 1)
    stranger.shows("#notices", "1 unsaved of anna on mission tiny are kept in this browser")
    stranger.state("saved")
    stranger.page.close()
    server.kill()
    server.mission = mine
    server.start()
    again = frame_page(browse(server, "#/label/left/22", context=context), 22)
    again.shows("#status", "1 of 100 labelled")
    again.state("saved")
    assert stored(server, 22) == {50: "sand"} and events(server, 22) == 1
