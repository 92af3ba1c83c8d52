"""Frames as pictures for reports: what was labelled, what was predicted, where it points."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np

from tokt.features.common.arrays import F64, U8
from tokt.features.extractors.extractor import gray_picture
from tokt.inference.verdict import OBSTACLE, Verdict
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.bundle.bundle import Bundle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SCALE = 2
_LABEL_BGR = (80, 220, 80)
_PREDICTED_BGR = (40, 120, 255)
_UNSURE_BGR = (170, 170, 170)
_BOX_BGR = (255, 220, 60)


def raise_contrast_gray(gray: U8) -> U8:
    """A nearly black frame made visible by local contrast; for eyes only, never for features."""
    return np.asarray(cv2.createCLAHE(6.0, (6, 6)).apply(gray), np.uint8)


def beside_labels(
    bundle: Bundle,
    image: U8,
    values: F64,
    verdict: Verdict,
    records: Iterable[LabelRecord],
    taxonomy: Taxonomy,
) -> U8:
    """The frame, contrast-enhanced, with its labels and what the model says, beside its mask.

    Left: thin green outlines are patches labelled as an obstacle, thin gray ones `unsure`, filled
    orange ones predicted. Right: the mask with its box and its centre; empty but where the status
    is 1. Values are the frame's decision values, (n_patches, n_outputs), the verdict is the
    runtime's in a run over the frames before, records are of this frame, one a patch.
    """
    grid, gray = bundle.grid, gray_picture(image, bundle.grid)
    height, width = gray.shape
    size = (width * _SCALE, height * _SCALE)
    view = cv2.cvtColor(cv2.resize(raise_contrast_gray(gray), size), cv2.COLOR_GRAY2BGR)
    boxes = grid.boxes(height, width) * _SCALE
    tint, predicted = view.copy(), bundle.model.obstacle_patches(values)
    for y0, y1, x0, x1 in boxes[predicted]:
        cv2.rectangle(tint, (x0, y0), (x1 - 1, y1 - 1), _PREDICTED_BGR, -1)
    view = cv2.addWeighted(view, 0.65, tint, 0.35, 0)
    for record in {(one.row, one.col): one for one in records}.values():
        y0, y1, x0, x1 = boxes[record.row * grid.cols + record.col]
        if record.label == UNSURE:
            cv2.rectangle(view, (x0 + 1, y0 + 1), (x1 - 2, y1 - 2), _UNSURE_BGR, 1)
        elif taxonomy.is_obstacle(str(record.label)):
            cv2.rectangle(view, (x0 + 1, y0 + 1), (x1 - 2, y1 - 2), _LABEL_BGR, 1)
    white = predicted & (verdict.status == OBSTACLE)
    mask = cv2.resize(grid.paint(white, height, width), size, interpolation=cv2.INTER_NEAREST)
    right = np.asarray(cv2.cvtColor(np.asarray(mask // 2, np.uint8), cv2.COLOR_GRAY2BGR), np.uint8)
    _draw_verdict(right, verdict, width, height)
    gap = np.full((size[1], 6, 3), 255, np.uint8)
    return np.hstack([view, gap, right]).astype(np.uint8)


def _draw_verdict(view: U8, verdict: Verdict, width: int, height: int) -> None:
    middle = (width // 2 * _SCALE, height // 2 * _SCALE)
    cv2.drawMarker(view, middle, (120, 120, 120), cv2.MARKER_CROSS, 16, 1)
    if verdict.box is None or verdict.x is None or verdict.y is None:
        return
    x, y, w, h = (value * _SCALE for value in verdict.box)
    cv2.rectangle(view, (x, y), (x + w - 1, y + h - 1), _BOX_BGR, 2)
    centre = (middle[0] - verdict.x * _SCALE, middle[1] - verdict.y * _SCALE)
    cv2.circle(view, centre, 7, _PREDICTED_BGR, -1)
    steer = (middle[0] + verdict.x * _SCALE, middle[1] + verdict.y * _SCALE)
    cv2.arrowedLine(view, middle, steer, _LABEL_BGR, 2, tipLength=0.15)


def jpeg_uri(image: U8, quality: int = 85) -> str:
    """A picture as a data URI, for a page that needs no other file."""
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return file_uri("jpeg", data.tobytes())


def new_figure(
    width: float, height: float, *shape: int, dpi: float | None = None, **given: Any
) -> tuple[Figure, Any]:
    """A figure of so many inches, and its axes as `Figure.subplots` gives them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, layout="constrained")
    return figure, figure.subplots(*shape, **given)


def figure_png(figure: Figure, dpi: float | Literal["figure"] = "figure") -> bytes:
    """A matplotlib figure as a PNG file, by default at its own resolution."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def file_uri(kind: str, data: bytes) -> str:
    """A picture's file (``png``, ``webp``) as a data URI, for a page that needs no other file."""
    return f"data:image/{kind};base64," + base64.b64encode(data).decode("ascii")


CONTRAST_METHOD = "lightness (CIELAB) by local contrast, CLAHE with clip limit 6 on 6x6 tiles"


def raise_contrast(frame: U8, width: int, height: int) -> U8:
    """A frame resized, with its contrast raised as `CONTRAST_METHOD` says.

    Of a gray or BGR frame, as decoded, (h, w) or (h, w, 3); RGB, (height, width, 3) pixels.
    """
    small = np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    if small.ndim == 2:
        return np.asarray(cv2.cvtColor(raise_contrast_gray(small), cv2.COLOR_GRAY2RGB), np.uint8)
    lab = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2LAB), np.uint8)
    lab[..., 0] = raise_contrast_gray(np.ascontiguousarray(lab[..., 0]))
    return np.asarray(cv2.cvtColor(lab, cv2.COLOR_LAB2RGB), np.uint8)
