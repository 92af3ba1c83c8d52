"""The page about many runs: a table of scenes and methods, and maps. One file, no network."""

import base64
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from tokt import __version__
from tokt.features.common import atomic
from tokt.studies.simulation.loop.track import IN_VIEW_M, Track
from tokt.studies.simulation.loop.vehicle import HULL_RADIUS_M
from tokt.training.evaluation.report import report_page

from .maps import Chart, animation, overview, still
from .outcome import CONFIDENCE, FRESH_S, outcome_of, table


def write_report(
    out: Path, tracks: Sequence[Track], charts: Sequence[Chart], words: Sequence[str]
) -> None:
    """Write ``report.html``, ``table.csv``, ``runs.csv`` and the maps of all runs into a folder.

    ``maps/SCENE-METHOD.png`` is the overview, ``maps/SCENE-METHOD-SEED.png`` the run that came
    nearest to something solid, and ``.webp`` that run as an animation, of each scene's first
    method. `words` are paragraphs: what was flown, and with what.
    """
    outcomes = [outcome_of(track) for track in tracks]
    rows = table(outcomes)
    atomic.write_text(out / "table.csv", rows.to_csv(index=False))
    runs = pd.DataFrame([outcome.to_json() for outcome in outcomes])
    atomic.write_text(out / "runs.csv", runs.to_csv(index=False))
    sections = _sections(out, tracks, charts)
    titles = {track.scene: track.title for track in tracks}
    page = report_page(
        __package__,
        version=__version__,
        words=words,
        rows=[_shown(row, titles) for row in rows.to_dict("records")],
        sections=sections,
        hull_m=HULL_RADIUS_M,
        confidence=CONFIDENCE,
        fresh_s=FRESH_S,
        in_view_m=IN_VIEW_M,
    )
    atomic.write_text(out / "report.html", page)


def _sections(out: Path, tracks: Sequence[Track], charts: Sequence[Chart]) -> list[dict[str, Any]]:
    """Write the maps of each scene with a method; what the page shows of them."""
    groups: dict[tuple[str, str], list[tuple[Track, Chart]]] = {}
    for track, chart in zip(tracks, charts, strict=True):
        groups.setdefault((track.scene, track.method), []).append((track, chart))
    animated: set[str] = set()
    sections = []
    for (scene, method), group in groups.items():
        nearest, chart = min(group, key=lambda one: one[0].least_m)
        name = f"{scene}-{method}"
        all_runs = overview([track for track, _ in group], [chart for _, chart in group])
        files = {f"{name}.png": all_runs, f"{name}-{nearest.seed}.png": still(nearest, chart)}
        if scene not in animated:
            animated.add(scene)
            files[f"{name}-{nearest.seed}.webp"] = animation(nearest, chart)
        for file, data in files.items():
            atomic.write_bytes(out / "maps" / file, data)
        whole, *maps = (_uri(*file) for file in files.items())
        shown = {"nearest": nearest, "overview": whole, "maps": maps, "runs": len(group)}
        sections.append({**shown, "solid": math.isfinite(nearest.least_m)})
    return sections


def _uri(name: str, data: bytes) -> str:
    kind = "webp" if name.endswith(".webp") else "png"
    return f"data:image/{kind};base64," + base64.b64encode(data).decode("ascii")


def _shown(row: Mapping[Any, Any], titles: Mapping[str, str]) -> dict[str, str | int | bool]:
    """A row of the table in words."""

    def rate(name: str) -> str:
        low, high = 100 * row[f"{name}_low"], 100 * row[f"{name}_high"]
        return f"{row[name]} ({low:.1f} to {high:.1f} %)"

    def number(name: str, pattern: str) -> str:
        return "" if pd.isna(row[name]) else pattern.format(row[name])

    return {
        "scene": titles[row["scene"]],
        "method": row["method"],
        "runs": row["runs"],
        "hit": row["collided"] > 0,
        "collided": rate("collided"),
        "reached": rate("reached"),
        "false_avoidance": rate("false_avoidance"),
        "clearance_min": number("clearance_min_m", "{:.2f}"),
        "clearance_median": number("clearance_median_m", "{:.2f}"),
        "detour_median": number("detour_median", "{:.0%}"),
        "detour_most": number("detour_most", "{:.0%}"),
        "time": number("time_median_s", "{:.0f}"),
        "false_status": f"{row['false_status_frames']} / {row['frames']}",
    }
