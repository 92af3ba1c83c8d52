"""Nothing a person did is lost or counted twice: crashes, no server, two tabs, a full disk."""

import sqlite3

import pytest


def events(server, frame):
    """How many events of a frame the store holds."""
    with sqlite3.connect(server.workspace / "labels.db") as connection:
        query = "SELECT count(*) FROM events WHERE frame = ?"
        return int(connection.execute(query, (frame,)).fetchone()[0])


@pytest.fixture(scope="module")
def server(page_server):
    return page_server("--annotator", "anna")


def test_a_server_killed_in_the_middle_of_a_drag_loses_nothing(open_frame, server):
    view = open_frame(2, offline=True)
    view.label("5", 90)
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
    assert view.stored(2) == dict.fromkeys([*range(10), 90], "subsea_installation")
    assert events(server, 2) == 11


def test_actions_of_a_closed_tab_are_replayed_in_order_and_once(open_frame, server):
    view = open_frame(4, offline=True)
    view.press("d")
    view.wait(5)
    server.kill()
    view.label("1", 0, 1, 2)
    view.label("3", 1)
    view.label("e", 2)
    view.press("a")
    view.wait(4)
    view.label("2", 7, 8)
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
    again = open_frame(5, context=context)
    assert again.stored(5) == {0: "ocean", 1: "sand"}
    assert again.stored(4) == {7: "other"}
    assert events(server, 5) == 5 and events(server, 4) == 3
    again.page.reload()
    again.wait(5)
    again.state("saved")
    assert events(server, 5) == 5
    again.press("Control+Shift+z")
    again.shows("#toast", "Done again")
    assert again.stored(4) == {7: "other", 8: "other"}


def test_two_tabs_see_each_other_and_conflicts_are_listed(open_frame):
    one = open_frame(10)
    two = open_frame(10, context=one.page.context)
    one.label("3", 12)
    two.shows("#status", "1 of 100")
    # What tab two says meanwhile is on its way: here, held back until the other one has spoken.
    held = []
    two.page.route("**/api/actions", lambda route: held.append(route))
    two.press("1")
    two.drag(11, 13)
    two.state("saving")
    one.label("4", 11, 12)
    one.state("saved")
    held[0].continue_()
    two.page.unroute("**/api/actions")
    two.shows("#notices", "there is now “reef”")
    assert two.stored(10) == {11: "reef", 12: "reef", 13: "ocean"}
    item = two.page.get_by_text("Use all 2 of mine")
    assert not item.is_visible() and two.text("#notices summary") == "2 patches are not written"
    two.page.locator("#notices summary").click()
    item.click()
    two.state("saved")
    two.page.wait_for_selector("#notices", state="hidden")
    assert two.stored(10) == dict.fromkeys([11, 12, 13], "ocean")
    two.press("Control+z")
    two.shows("#toast", "Undone: resolve, 2 patches")
    assert two.stored(10) == {11: "reef", 12: "reef", 13: "ocean"}
    one.point(12)
    one.shows("#status", "row 1, column 2: reef")


def test_somebody_elses_labels_show_and_stay(open_frame, server):
    view = open_frame(12)
    view.label("1", 5)
    view.point(5)
    server.paint("ben-12", 12, [5], "reef", who="ben")
    view.shows("#status", "ben: reef, disagreement")
    view.label("e", 5)
    assert view.stored(12) == {} and view.stored(12, "ben") == {5: "reef"}


def test_an_answer_from_before_a_change_does_not_hide_it(open_frame, server):
    view = open_frame(30, alone=True)  # another tab of the browser may have told of frame 40
    held = []
    holding = True

    def hold(route):
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


def test_only_the_person_says_who_works_here_also_without_a_server(open_frame, server):
    server.paint("ben-33", 33, [5], "reef", who="ben")
    view = open_frame(33, offline=True, alone=True)  # somebody else works there in the end
    view.point(5)
    view.shows("#status", "ben: reef")
    server.kill()
    view.state("offline")
    view.page.locator("#person").click()
    view.page.locator("#person-name").fill(" carl\u200b ")
    view.page.get_by_text("Label as this").click()
    view.shows("#toast", "not loaded anew")
    assert view.text("#person") == "Labelling as carl" and "ben" not in view.text("#status")
    view.page.locator("#person").click()
    view.page.locator("#person-blind").check()
    view.page.get_by_text("Label as this").click()
    view.shows("#toast", "Not done")
    mine, server.arguments = server.arguments, ("--annotator", "ben")
    server.start()
    view.wait(33)
    view.state("saved")
    assert view.text("#person") == "Labelling as carl"
    view.label("3", 6)
    assert view.stored(33, "carl") == {6: "sand"}
    assert view.stored(33, "ben") == {5: "reef"} and view.stored(33) == {}
    view.page.close()
    server.kill()
    server.arguments = mine
    server.start()


def test_a_refused_action_is_set_aside_and_later_ones_go_on(open_frame):
    view = open_frame(15, allow="400")

    def spoil(route):
        route.continue_(post_data=route.request.post_data.replace('"sand"', '"no such class"'))

    view.page.route("**/api/actions", spoil)
    view.label("3", 20)
    view.shows("#notices", "The server refused paint (1 patch on left frame 15)")
    view.label("4", 21)
    view.shows("#status", "row 2, column 1: reef")
    assert view.stored(15) == {21: "reef"}
    view.page.reload()
    view.wait(15)
    view.shows("#notices", "The server refused")
    view.page.locator("#notices summary").click()
    view.page.get_by_text("Discard").click()
    view.page.wait_for_selector("#notices", state="hidden")


def test_a_full_disk_is_said_and_nothing_pretends_to_be_saved(open_frame):
    view = open_frame(17, allow="507")
    full = {"status": 507, "json": {"error": "label store labels.db: database or disk is full"}}
    view.page.route("**/api/actions", lambda route: route.fulfill(**full))
    view.label("3", 30)
    view.state("refused")
    view.shows("#notices", "database or disk is full")
    assert "1 waiting" in view.text("#save-state") and not view.records(17)
    view.page.unroute("**/api/actions")
    # Not by the mouse: where the page has tried by itself meanwhile, the button is gone.
    view.page.locator("#try-now").dispatch_event("click")
    assert view.stored(17) == {30: "sand"}


def test_without_storage_nothing_is_taken_while_the_server_is_away(open_frame, server):
    view = open_frame(19, offline=True)
    view.page.evaluate("() => { Storage.prototype.setItem = () => { throw new Error('full') } }")
    view.label("3", 40)
    view.state("saved")
    server.kill()
    view.state("offline")
    view.click(41)
    view.shows("#toast", "cannot keep actions")
    server.start()
    assert view.stored(19) == {40: "sand"}


def test_another_mission_on_the_same_port_gets_none_of_it(open_frame, server, own_tiny):
    other = own_tiny.path.rename(own_tiny.path.with_name("elsewhere"))
    view = open_frame(22, offline=True, alone=True, allow="421")
    server.kill()
    view.label("3", 50)
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
    stranger = open_frame(1, context=context)
    stranger.shows("#notices", "1 unsaved of anna on mission tiny are kept in this browser")
    stranger.state("saved")
    stranger.page.close()
    server.kill()
    server.mission = mine
    server.start()
    again = open_frame(22, context=context)
    again.shows("#status", "1 of 100 labelled")
    assert again.stored(22) == {50: "sand"} and events(server, 22) == 1
