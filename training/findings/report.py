"""Findings as one HTML file that needs no other: a strip along the track, a picture of each."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError
from tokt.features.common.machine import installed_version
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.inference.replay.findings import InspectionFinding
from tokt.labels.formats.text_file import save_text
from tokt.labels.page.state.enhance import enhanced
from tokt.training.evaluation.pictures import jpeg_uri
from tokt.training.evaluation.report import report_page

_WIDTH = 360
_OUTLINE_BGR = (40, 200, 255)
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")


def write_findings_page(
    path: Path,
    findings: Sequence[InspectionFinding],
    missions: Mapping[str, Mission | None],
    classes: Sequence[str],
) -> None:
    """Write the page, with the picture of each finding whose mission is there.

    `missions` are by a finding's run; `classes` are those that were looked for. Raises ToktError if
    the file cannot be written.
    """
    names = sorted({found.label for found in findings})
    colours = {name: _COLOURS[at % len(_COLOURS)] for at, name in enumerate(names)}
    runs: dict[str, list[tuple[int, InspectionFinding, str]]] = {run: [] for run in missions}
    for number, found in enumerate(findings, 1):
        runs[found.run].append((number, found, _picture(found, missions[found.run])))
    strips = {run: _strip(rows, colours) for run, rows in runs.items()}
    version = installed_version("tokt")
    save_text(
        path,
        report_page(
            __package__, runs=runs, strips=strips, colours=colours, classes=classes, version=version
        ),
    )


def _strip(
    rows: list[tuple[int, InspectionFinding, str]], colours: Mapping[str, str]
) -> dict[str, Any]:
    """Where along the track each finding stands, in per cent of its way."""
    placed = [(number, found) for number, found, _ in rows if found.along_m is not None]
    ways = [found.along_m or 0.0 for _, found in placed]
    end = max(ways, default=0.0) * 1.02 or 1.0
    marks = [
        {"number": number, "at": 100 * way / end, "colour": colours[found.label], "found": found}
        for (number, found), way in zip(placed, ways, strict=True)
    ]
    return {"end": end, "marks": marks}


def _picture(found: InspectionFinding, mission: Mission | None) -> str:
    """The best frame as a data URI, its patches outlined; empty where it is not there."""
    if mission is None:
        return ""
    try:
        frame = mission.read(found.best_frame)
    except FrameError:
        return ""
    return jpeg_uri(_outlined(frame, Grid.parse(found.grid), found.patches))


def _outlined(frame: U8, grid: Grid, patches: Sequence[int]) -> U8:
    """A frame, small, with one outline around the patches."""
    height, width = grid.resized(*frame.shape[:2])
    size = (_WIDTH, round(_WIDTH * height / width))
    view = np.asarray(cv2.resize(enhanced(frame), size, interpolation=cv2.INTER_AREA), np.uint8)
    view = view if view.ndim == 3 else np.asarray(cv2.cvtColor(view, cv2.COLOR_GRAY2BGR), np.uint8)
    chosen = np.zeros(grid.n_patches, bool)
    chosen[list(patches)] = True
    mask = cv2.resize(grid.paint(chosen, height, width), size, interpolation=cv2.INTER_NEAREST)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(view, contours, -1, _OUTLINE_BGR, 2)
    return view
