"""Make the tables of docs/explanation/waters.md from what the product answers.

``python docs/make_waters_page.py BY_SITE.json BY_DIVE.json ADAPTED.jsonl BEGUN.jsonl LITE.json``

The first two are the answers of ``tokt train DATASET --stress --json`` and of the same without
``--stress`` and with ``--site NAME=NAME`` for one dive, so that dives are held out and not sites.
Each line of the third is about one dive, to which a model of the other sites was adapted with some
of its frames: mission, labelled (frames), times, before and after (F1 and AP on its other frames),
mean, worst and worst_dive (changes of F1 of the old dives). The fourth is the same of ``waters``,
the model that comes with tokt, as `measure_adaptation.py` writes it. The fifth is the answer of
``tokt train DATASET --preset lite --json``.
What stands outside of the marks is written by hand, and so is what a dive shows.
"""

import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).parent / "explanation" / "waters.md"
NO_WATER = 0.95  # part of a dive's labelled patches that are obstacles: from there F1 says nothing
DRAWN = ("gain", "gamma", "jpeg", "noise", "gray")
"""Kinds of augmentation that training's random changes draw as well."""
_TABLE = re.compile(r"<!-- table (\w+) -->\n.*?<!-- end -->\n", re.DOTALL)
_BOTH = ("f1", "average_precision")


def main(by_site: str, by_dive: str, adapted: str, begun: str, lite: str) -> None:
    """Write the page."""
    site, dive, half = (
        json.loads(Path(file).read_text("utf-8"))["cv"] for file in (by_site, by_dive, lite)
    )
    rows, of_waters = (
        [json.loads(line) for line in Path(file).read_text("utf-8").splitlines()]
        for file in (adapted, begun)
    )
    page = PAGE.read_text("utf-8")
    # Its first row is the one of a dive that says what it shows.
    shows = dict(reversed(re.findall(r"^\| `([^`]+)` \| ([^|]*) \|", page, re.MULTILINE)))
    tables = {
        "dives": dives_table(site["dives"], dive["dives"], half["dives"], shows),
        "changes": changes_table(site["dives"], site["stress"]),
        "adapted": adapted_table(rows),
        "begun": adapted_table(of_waters),
    }
    PAGE.write_text(filled(page, tables), "utf-8")


def filled(page: str, tables: Mapping[str, str]) -> str:
    """Return a page with each table in place of what stands between its marks."""
    return _TABLE.sub(
        lambda mark: f"<!-- table {mark[1]} -->\n{tables[mark[1]]}<!-- end -->\n", page
    )


def dives_table(
    by_site: Mapping[str, Any],
    by_dive: Mapping[str, Any],
    lite: Mapping[str, Any],
    shows: Mapping[str, str],
) -> str:
    """Return a row for each dive, judged without its site and without itself, and their means.

    The last column is of another preset, judged without the dive's site.
    """
    rows, judged = [], (by_site, by_dive, lite)
    for name, one in sorted(by_site.items()):
        pairs = [_pair(found[name]) if has_water(one) else "- / -" for found in judged]
        sides = (_figure(one[key]) for key in ("precision", "recall"))
        rows.append([f"`{name}`", shows.get(name, ""), pairs[0], *sides, *pairs[1:]])
    watered = [name for name, one in by_site.items() if has_water(one)]
    means = [_mean_pair(found[name] for name in watered) for found in judged]
    rows.append(["mean", f"of the {len(watered)} that have water", means[0], "", "", *means[1:]])
    head = ("dive", "what", "site held out: F1 / AP", "precision", "recall", "dive held out")
    head += ("`lite_water`, site held out",)
    return _table(head, rows)


def changes_table(dives: Mapping[str, Any], stress: Mapping[str, Any]) -> str:
    """Return a row for each augmentation of the held-out frames: means over dives with water."""
    watered = [name for name, one in dives.items() if has_water(one)]
    new = [one["dives"] for name, one in stress.items() if not _is_drawn(name)]
    rows = [["as they are", _mean_pair(dives[name] for name in watered), ""]]
    for name, one in stress.items():
        figures = _mean_pair(one["dives"][dive] for dive in watered)
        rows.append([f"`{name}`", figures, "yes" if _is_drawn(name) else "no"])
    figures = _mean_pair(one[dive] for one in new for dive in watered)
    rows.append(["mean of the kinds that training does not draw", figures, "no"])
    return _table(("frames", "F1 / AP", "kind drawn in training"), rows)


def adapted_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a row for each dive, a column for each number of labelled frames, and the means."""
    counts = sorted({one["labelled"] for one in rows})
    lines = []
    for name in sorted({one["mission"] for one in rows}):
        mine = {one["labelled"]: one for one in rows if one["mission"] == name}
        before = dict(zip(_BOTH, mine[min(mine)]["before"], strict=True))
        cells = [_adapted([mine[count]]) if count in mine else "" for count in counts]
        lines.append([f"`{name}`", _pair(before), *cells])
    means = [_adapted([one for one in rows if one["labelled"] == count]) for count in counts]
    return _table(("new dive", "0 frames", *counts), [*lines, ["mean, worst of all", "", *means]])


def _adapted(rows: Sequence[Mapping[str, Any]]) -> str:
    """Say what new dives gain in the mean, and the most that an old one loses."""
    if all(one["worst_dive"] == "refused" for one in rows):
        return "refused"
    gains = np.mean([np.subtract(one["after"], one["before"]) for one in rows], axis=0)
    return f"{gains[0]:+.2f} / {gains[1]:+.2f}; {min(one['worst'] for one in rows):+.3f}"


def has_water(dive: Mapping[str, Any]) -> bool:
    """Return whether a dive has obstacles, and enough open water for F1 to tell anything."""
    return bool(0 < dive["obstacles"] < NO_WATER * dive["n"])


def _is_drawn(augmentation: str) -> bool:
    return augmentation.startswith(DRAWN)


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _pair(figures: Mapping[str, Any]) -> str:
    return " / ".join(_figure(figures[key]) for key in _BOTH)


def _mean_pair(dives: Iterable[Mapping[str, Any]]) -> str:
    listed = list(dives)
    return _pair({key: float(np.mean([one[key] for one in listed])) for key in _BOTH})


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(map(str, cells))} |\n" for cells in lines)


if __name__ == "__main__":
    main(*sys.argv[1:])
