"""Make the pictures of docs/how-to/label.md and docs/how-to/view.md from a finished rendered demo.

``python docs/make_page_pictures.py demo-out`` starts the labelling page on the demo's rendered
mission with its model and some of its labels, then a run with a live view, and takes pictures of
both in headless Chromium.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
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
            sign_in(page, url)
            for view, address in VIEWS.items():
                page.goto(f"{url.partition('?')[0]}{address}")
                page.wait_for_timeout(SETTLED_MS)
                page.screenshot(path=PICTURES / f"{view}.jpg", type="jpeg", quality=82)
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
    anna = pd.read_csv(mission / "labels.csv").query("frame <= @LABELLED").reset_index()
    ben = anna[anna.frame % 10 == 0].copy()
    ben.loc[ben.index % 97 == 0, "label"] = "unsure"
    for who, labels in (("anna", anna), ("ben", ben)):
        path = workspace / f"{who}.csv"
        labels.drop(columns="index").to_csv(path, index=False)
        tokt("labels", "import", path, "--workspace", workspace)
    build = ("--mission", mission, "--labels", workspace / "anna.csv", "--block", 5)
    tokt("dataset", "build", mission.name, *build, "--workspace", workspace)
    tokt("labels", "audit", mission.name, "--workspace", workspace)


def tokt(*arguments: object) -> list[str]:
    """What a command prints, line by line."""
    command = [TOKT, *map(str, arguments)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return (done.stderr + done.stdout).splitlines()


def sign_in(page: Page, url: str) -> None:
    """Open the labelling page as anna."""
    page.add_init_script("""try { localStorage["tokt.identity"] = '{"who": "anna"}' } catch {}""")
    page.goto(url)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
