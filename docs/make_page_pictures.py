"""Make the pictures of docs/how-to/label.md and docs/how-to/view.md from a finished rendered demo.

``python docs/make_page_pictures.py demo-out`` starts the labelling page on the demo's rendered
mission with its model and some of its labels, then a run with a live view, and takes pictures of
both in headless Chromium.
"""

import csv
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

PICTURES = Path(__file__).parent / "pictures"
TOKT = Path(sys.executable).parent / "tokt"
READY = re.compile(r"http://\S+")
SETTLED_MS = 4000  # pictures and suggestions of all frames shown have come by then
LABELLED = 60  # frames that anna labelled; ben some of them, and some of it otherwise
VIEWS = {
    "label": "#/label/left/86",
    "overview": "#/overview/left/61",
    "sheet": "#/sheet/subsea_installation",
    "audit": "#/audit",
    "agreement": "#/agreement/anna/ben",
    "files": "#/files",
}


def main(out: Path) -> None:
    """Serve the demo's mission, and take the pictures."""
    bundle, mission = next(out.glob("*.tokt")), out / "synthetic"
    with tempfile.TemporaryDirectory() as name:
        workspace = Path(name)
        give_labels(mission, workspace)
        options = ["--no-browser", "--port", "0", "--annotator", "anna", "--workspace", workspace]
        with served("label", mission, *options, "--model", bundle) as url, tab(1280, 720) as page:
            take(page, url)
    run_options = ["--source", mission, "--rate", "10", "--udp", "127.0.0.1:9", "--view", "0"]
    with served("run", "--bundle", bundle, *run_options) as url, tab(720, 800) as page:
        page.goto(url)
        page.wait_for_selector("dd:has-text('OBSTACLE')")
        page.wait_for_timeout(SETTLED_MS)
        page.wait_for_selector("dd:has-text('OBSTACLE')")
        page.screenshot(path=PICTURES / "view.jpg", type="jpeg", quality=82)


@contextmanager
def served(*arguments: object) -> Iterator[str]:
    """The address that a command of `tokt` prints as it serves a page."""
    command = [TOKT, *map(str, arguments)]
    out = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, **out, text=True) as server:
        try:
            assert server.stdout is not None
            yield next(found[0] for line in server.stdout if (found := READY.search(line)))
        finally:
            server.terminate()


@contextmanager
def tab(width: int, height: int) -> Iterator[Page]:
    """A page of headless Chromium of that size."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser.new_page(viewport={"width": width, "height": height})
        browser.close()


def give_labels(mission: Path, workspace: Path) -> None:
    """What two people labelled, and an audit of it."""
    with (mission / "labels.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if int(row["frame"]) <= LABELLED]
    for who in ("anna", "ben"):
        path = workspace / f"{who}.csv"
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            for at, row in enumerate(rows):
                if who == "anna" or int(row["frame"]) % 10 == 0:
                    other = at % 97 == 0 and row["label"] != "unsure"
                    writer.writerow({**row, "label": "unsure"} if other and who == "ben" else row)
        run("labels", "import", path, "--workspace", workspace)
    build = ("--mission", mission, "--labels", workspace / "anna.csv", "--block", 5)
    run("dataset", "build", mission.name, *build, "--workspace", workspace)
    run("labels", "audit", mission.name, "--workspace", workspace)


def run(*arguments: object) -> None:
    """Run a command of `tokt`."""
    subprocess.run([TOKT, *map(str, arguments)], check=True)


def take(page: Page, url: str) -> None:
    """A picture of each view of the labelling page."""
    page.add_init_script("""try { localStorage["tokt.identity"] = '{"who": "anna"}' } catch {}""")
    page.goto(url)
    for name, address in VIEWS.items():
        show(page, f"{url.partition('?')[0]}{address}", f"{name}.jpg")


def show(page: Page, address: str, name: str) -> None:
    """Open a view and keep its picture."""
    page.goto(address)
    page.wait_for_timeout(SETTLED_MS)
    page.screenshot(path=PICTURES / name, type="jpeg", quality=82)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
