"""Files, classes, models and audits in a real browser: what a person gets and the store holds."""

import csv
import io

import pytest

from tests.calls import succeeds
from tests.labels.page.conftest import knows
from tests.waiting import until
from tokt.labels.store.store import LabelStore
from tokt.models.bundle.bundle import read_bundle

CARD = "section.card:has(h2:text-is('{}'))"


@pytest.fixture(scope="module")
def server(page_server):
    return page_server("--annotator", "anna")


@pytest.fixture
def page(browse, server):
    page = browse(server, "#/files", allow="40[09]")
    page.wait_for_selector(".classes")
    return page


def held(server):
    with LabelStore(server.workspace / "labels.db") as store:
        return {(one.frame, one.row, one.col): one.label for one in store.current()}


def upload(page, name, text):
    page.set_input_files(
        "input[type=file]", {"name": name, "mimeType": "", "buffer": text.encode()}
    )


def test_a_file_comes_in_after_its_classes_are_named_and_goes_out_whole(page, server):
    card = page.locator(CARD.format("Import labels"))
    rows = ["mission,camera,frame,row,col,label", "tiny,left,3,0,0,ocean", "tiny,left,3,0,1,kelp"]
    upload(page, "ben.csv", "\n".join(rows))
    card.get_by_text("What are they here?").wait_for()
    assert held(server) == {}
    card.get_by_label("kelp").select_option("reef")
    card.get_by_role("button", name="Go on").click()
    card.get_by_text("The file has 2 labels by ben: 2 new.").wait_for()
    assert held(server) == {}
    card.get_by_role("button", name="Import 2 labels").click()
    card.get_by_text("Imported 2 labels by ben").wait_for()
    assert held(server) == {(3, 0, 0): "ocean", (3, 0, 1): "reef"}
    page.reload()
    out = page.locator(CARD.format("Export labels"))
    out.get_by_text("2 labels of tiny.").wait_for()
    with page.expect_download() as got:
        out.get_by_role("link", name="Download").click()
    text = got.value.path().read_text("utf-8")
    assert [row["label"] for row in csv.DictReader(io.StringIO(text))] == ["ocean", "reef"]
    upload(page, "bad.csv", "\n".join([rows[0], "tiny,left,x,0,1,ocean"]))
    card.get_by_text("bad.csv line 2").wait_for()


def test_classes_are_added_saved_and_in_use_at_once(page, server):
    page.get_by_role("button", name="Add a class").click()
    row = page.locator(".classes tbody tr").last
    row.get_by_label("name", exact=True).fill("giant kelp")
    row.get_by_label("key of").fill("9")
    row.get_by_label("is a kind of").fill("kelp")
    page.get_by_role("button", name="earlier").last.click()
    page.get_by_label("sand is a kind of").fill("reef")
    page.get_by_role("button", name="Save the classes").click()
    page.wait_for_function("() => /are saved/.test(document.querySelector('#toast').textContent)")
    names = [known["name"] for known in server.get("/api/classes")["classes"]]
    assert names[-2:] == ["giant kelp", "subsea_installation"]
    page.locator("#views a", has_text="Label").first.click()
    page.wait_for_selector("text=giant kelp")
    palette = page.locator(".painters").inner_text().split("\n")
    words = [word for word in palette if len(word) > 1]
    assert words[2:6] == ["reef", "sand", "kelp", "giant kelp"]  # kelp is a group, no class
    left = [page.get_by_role("button", name=name).bounding_box()["x"] for name in words[2:4]]
    assert left[0] < left[1]
    page.go_back()
    page.wait_for_selector(".classes")
    page.locator(".classes tbody tr").last.get_by_label("key of").fill("9")  # taken already
    page.get_by_role("button", name="Save the classes").click()
    page.wait_for_function(
        "() => /Not saved: .*key/.test(document.querySelector('#toast').textContent)"
    )


def test_a_model_of_the_labels_is_trained_and_suggests_and_labels_are_audited(
    browse, page_server, tiny_truth, workspace, tmp_path
):
    rows = [row for row in tiny_truth.labels() if row[2] % 4 == 0 and row[3] in (3, 4)]
    row = next(row for row in reversed(rows) if row[-1] == "subsea_installation")
    row[-1] = "ocean"
    file = tiny_truth.write_labels(tmp_path / "anna.csv", rows)
    succeeds("labels", "import", file, "--workspace", workspace)
    server = page_server("--annotator", "anna", workspace=workspace)
    page = browse(server, "#/files")
    card = page.locator(CARD.format("Model and audit"))
    card.get_by_text("There is no model yet").wait_for()
    card.get_by_role("button", name="Train a model").click()
    card.get_by_role("button", name="Cancel").click()
    card.get_by_text("The model was cancelled").wait_for()
    assert server.get("/api/mission")["model"] is None
    with server.events(who="anna") as stream:
        told = [stream.next("status")]
        card.get_by_role("button", name="Train a model").click()
        while told[-1]["job"]["state"] != "done":
            told.append(stream.next("status"))
            assert told[-1]["job"]["state"] != "failed", told[-1]
    steps = [one["job"]["progress"] for one in told if one["job"]["progress"]]
    assert {"features", "cross-validation"} & {step["what"] for step in steps}
    assert all(0 <= step["done"] <= step["total"] for step in steps)
    assert told[-1]["setup"] != told[0]["setup"]
    card.get_by_text("The model is ready.").wait_for()
    result = server.get("/api/job")["job"]["result"]
    assert result and "Done" not in card.inner_text()
    assert card.locator(".job li").all_inner_texts() == [" ".join(one.split()) for one in result]
    page.locator("#views a", has_text="Label").first.click()
    until(lambda: knows(page, "model?.label === 'tiny/1'"))  # without loading the page again
    bundle = read_bundle(server.workspace / "models" / "tiny.tokt")
    assert server.get("/api/mission")["model"]["label"] == bundle.label == "tiny/1"
    (found,) = server.get("/api/labels", camera="left", frames="3", suggest=1)["frames"]
    assert found["suggestions"]["model"] == "tiny/1"
    page.go_back()
    card.get_by_role("button", name="Look for labels").click()
    card.get_by_role("button", name="Look at them").click()
    page.wait_for_selector(".tab:has-text('Audit tiny')")
    page.close()
    server.interrupt()
    server.start()
    assert server.get("/api/mission")["model"]["label"] == "tiny/1"
