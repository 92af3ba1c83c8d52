"""The docs' site: built without a warning, and at work in a browser that has no network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

# One worker: the site is built once.
pytest.importorskip("material", reason="make docs installs what builds the site")

ROOT = Path(__file__).parents[3]
GENERATED = {
    "command_line": ("tokt train", "--extractor", "tokt run"),
    "config": ("heartbeat", "A frame older than this is never clear."),
    "report": ("closing_m_s", "place_age_ms"),
    "reasons": ("camera_lost", "What to do"),
    "metrics": ("tokt_verdicts_total",),
    "exit_codes": ("130",),
    "formats": ("labels.db", "taxonomy.toml"),
    "python": ("open_mission", "build_dataset", "load_model", "PatchFeatures"),
}
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)|<img[^>]* src=\"([^\"]+)\"", re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built strictly: a dead link fails. TOKT_SITE names that of `make docs`."""
    if "TOKT_SITE" in os.environ:
        return Path(os.environ["TOKT_SITE"]).resolve()
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, text=True, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


@pytest.fixture
def tab(browser):
    """A page that may open files alone; what it asks for besides, and complains of, is kept."""
    page = browser.new_page()
    page.complaints = []
    page.on("console", lambda told: page.complaints.append(told.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    # Not what leaving a page cuts off.
    gone = "net::ERR_ABORTED"
    page.on("requestfailed", lambda it: it.failure == gone or page.complaints.append(it.url))
    page.route(re.compile("^(?!file:|data:|blob:)"), lambda route: route.abort())
    yield page
    page.close()


@pytest.mark.parametrize("name", GENERATED)
def test_a_page_made_from_the_code_is_there(site, name):
    text = re.sub(r"<[^>]+>", "", (site / f"reference/{name}.html").read_text())
    assert [words for words in GENERATED[name] if words.lower() not in text.lower()] == []


def test_the_site_holds_no_bytecode(site):
    assert [*site.rglob("__pycache__"), *site.rglob("*.py*")] == []


def test_every_page_opens_without_a_network(site, tab):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for path in pages:
        tab.goto(path.as_uri(), wait_until="load")
        assert (path.name, tab.complaints) == (path.name, [])


def test_nothing_of_the_site_is_loaded_from_elsewhere(site):
    loaded = re.compile(r"(?:src|srcset)=\"?https?:[^\"> ]*|<link[^>]*href=\"?https?:[^>]*")
    for path in site.rglob("*.html"):
        asked = [one for one in loaded.findall(path.read_text()) if 'rel="canonical"' not in one]
        assert (path.name, asked) == (path.name, [])


def test_the_search_finds_a_page_from_a_folder(site, tab):
    tab.goto((site / "index.html").as_uri())
    tab.keyboard.press("/")
    tab.keyboard.type("operating point")
    found = tab.locator(".md-search-result__item a.md-search-result__link")
    found.first.wait_for()
    addresses = [one.get_attribute("href") for one in found.all()]
    assert any("operating_point.html" in address for address in addresses)
    tab.goto(addresses[0])
    assert "operating point" in tab.inner_text("article").lower()
    assert tab.complaints == []


@pytest.mark.parametrize("width", [1280, 400])
def test_the_home_page_fits_a_wide_and_a_narrow_window(site, tab, width):
    tab.set_viewport_size({"width": width, "height": 900})
    tab.goto((site / "index.html").as_uri())
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    broken = "Array.from(document.images).filter(one => !one.naturalWidth).map(one => one.src)"
    assert tab.locator("article img").count() > 0
    assert tab.evaluate(broken) == []


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_links_of_the_top_pages_lead_to_files_and_headings(site, name):
    """Those of docs/ are checked when the site is built; its pages have the headings' anchors."""
    dead = []
    for link in (first or second for first, second in LINK.findall((ROOT / name).read_text())):
        if re.match(r"https?:|mailto:", link):
            continue
        path, _, anchor = link.partition("#")
        there = (ROOT / path).exists() if path else True
        if anchor and path.startswith("docs/"):
            page = (site / path.removeprefix("docs/")).with_suffix(".html")
            there = there and f'id="{anchor}"' in page.read_text()
        dead += [link] * (not there)
    assert dead == []
