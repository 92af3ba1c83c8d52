"""What the page is made of: its start is fetched at once, and nothing runs from the markup."""

import re
from pathlib import Path

from tokt.labels import page

STATIC = Path(page.__file__).parent / "static"
_IMPORT = re.compile(r"""^(?:import|export|\})[^;"]*"(\.\.?/[\w./]+)";""", re.MULTILINE)


def imported(module, found):
    """All modules that one loads before it runs."""
    found.add(module)
    path = STATIC / module
    for text in _IMPORT.findall(path.read_text("utf-8")):
        other = (path.parent / text).resolve().relative_to(STATIC.resolve()).as_posix()
        if other not in found:
            imported(other, found)
    return found


def test_all_modules_of_the_start_are_preloaded():
    index = (STATIC / "index.html").read_text("utf-8")
    preloaded = re.findall(r'rel="modulepreload" href="/static/([\w./]+)"', index)
    needed = imported("start/main.js", set()) - {"start/main.js"}
    assert len(needed) > 20
    assert sorted(preloaded) == sorted(needed)


def test_markup_and_modules_keep_to_the_content_security_policy():
    index = (STATIC / "index.html").read_text("utf-8")
    assert not re.search(r"<style|style=|\son\w+=|<script>", index)
    for module in STATIC.rglob("*.js"):
        text = module.read_text("utf-8")
        assert not re.search(r"innerHTML|insertAdjacentHTML|\beval\(|new Function", text), module


def test_the_core_names_no_other_room_not_even_for_its_types():
    """Code is held by eslint.config.js; types are named in comments."""
    for module in (STATIC / "core").glob("*.js"):
        assert '"../' not in module.read_text("utf-8"), module
