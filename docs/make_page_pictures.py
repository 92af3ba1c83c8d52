"""Make docs/label.jpg and docs/overview.jpg from a finished rendered demo.

``python docs/make_page_pictures.py demo-out`` starts the labelling page on the demo's rendered
mission with its model, labels a few frames, and takes pictures of it in headless Chromium.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

HERE = Path(__file__).parent
TOKT = Path(sys.executable).parent / "tokt"
READY = re.compile(r"http://\S+")
SETTLED_MS = 3000  # pictures and suggestions of all frames shown have come by then


def main(out: Path) -> None:
    """Serve the demo's mission, and take the pictures."""
    bundle = next(out.glob("*.tokt"))
    with tempfile.TemporaryDirectory() as workspace:
        options = ["--no-browser", "--port", "0", "--annotator", "anna", "--workspace", workspace]
        server = subprocess.Popen(
            [TOKT, "label", out / "synthetic", *options, "--model", bundle],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert server.stdout is not None
            found = READY.search(server.stdout.readline())
            assert found is not None
            take(found[0])
        finally:
            server.terminate()
            server.wait()


def take(url: str) -> None:
    """Both pictures, as a person with 1280x720 pixels sees the page."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.add_init_script("""localStorage["tokt.identity"] = '{"who": "anna"}'""")
        show(page, f"{url}#/overview/left/61", "overview.jpg")
        show(page, f"{url}#/label/left/86", "label.jpg")
        browser.close()


def show(page: Page, address: str, name: str) -> None:
    """Open a view and keep its picture."""
    page.goto(address)
    page.wait_for_timeout(SETTLED_MS)
    page.screenshot(path=HERE / name, type="jpeg", quality=82)


main(Path(sys.argv[1]))
