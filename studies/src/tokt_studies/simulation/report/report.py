"""The page about many runs: a table of scenes and methods, and maps. One file, no network."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from tokt import __version__
from tokt.features.common import atomic
from tokt.training.evaluation.pictures import file_uri
from tokt.training.evaluation.report import report_page
from tokt_studies.simulation.loop.track import IN_VIEW_M, Track
from tokt_studies.simulation.loop.vehicle import HULL_RADIUS_M

from .maps import Chart, animation, overview, still
from .outcome import CONFIDENCE, FRESH_S, GROUND_IN_VIEW, outcome_of, table


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
    page = report_page(
        __package__,
        version=__version__,
        words=words,
        titles={track.scene: track.title for track in tracks},
        rows=rows.astype(object).where(rows.notna(), None).to_dict("records"),
        sections=sections,
        hull_m=HULL_RADIUS_M,
        confidence=CONFIDENCE,
        fresh_s=FRESH_S,
        ground_in_view=GROUND_IN_VIEW,
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
        whole, *maps = (file_uri(Path(file).suffix[1:], data) for file, data in files.items())
        shown = {"nearest": nearest, "overview": whole, "maps": maps, "runs": len(group)}
        sections.append({**shown, "solid": math.isfinite(nearest.least_m)})
    return sections
