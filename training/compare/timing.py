"""Time of each model for a frame, measured on this machine."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.machine import machine
from tokt.features.frames.image_file import decode_image
from tokt.features.kernels.dispatch import KERNELS
from tokt.inference.policy.policy import judge_image
from tokt.models.bundle.bundle import Bundle

from .predictions import MISSION, ComparedModels

_FRAMES = 10
_MIN_RUNS = 30


def _pictures(compared: ComparedModels) -> tuple[list[NDArray[np.uint8]], str]:
    """Some frames for all models alike."""
    if compared.mode == MISSION and compared.read_frame is not None:
        table = compared.series.table
        rows = np.unique(np.linspace(0, len(table) - 1, _FRAMES).round().astype(int))
        keys = table.loc[rows, ["mission", "camera", "frame"]].itertuples(index=False, name=None)
        return [compared.read_frame(*key) for key in keys], f"{len(rows)} frames of the mission"
    golden = compared.models[0].bundle.content.golden.frames
    what = "1 golden frame" if len(golden) == 1 else f"{len(golden)} golden frames"
    return [decode_image(png, "golden frame") for png in golden], what


@contextmanager
def _one_thread() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def measure_times(compared: ComparedModels) -> dict[str, Any]:
    """Time from a decoded frame to its verdict.

    Models take turns frame by frame, each beginning as often as the others, so that whatever else
    the machine does falls on all alike.

    Returns
    -------
    dict
        how (in words), kernels, cpu, and models: {label: {median_ms, low_ms, high_ms, runs}} with
        the 10th and the 90th percentile.
    """
    bundles = [predictions.bundle for predictions in compared.models]
    pictures, what = _pictures(compared)
    rounds = -(-_MIN_RUNS // len(pictures))
    spent: dict[str, list[float]] = {bundle.label: [] for bundle in bundles}
    with _one_thread():
        for bundle in bundles:
            judge_image(bundle, pictures[0])
        for turn in range(rounds * len(pictures)):
            for bundle in _turned(bundles, turn):
                begun = time.perf_counter()
                judge_image(bundle, pictures[turn % len(pictures)])
                spent[bundle.label].append(1000 * (time.perf_counter() - begun))
    return {
        "how": f"{what}, decoded frame to verdict, one thread, models taking turns",
        "kernels": KERNELS.name,
        "cpu": machine()["cpu"],
        "models": {label: _summary(values) for label, values in spent.items()},
    }


def _turned(bundles: Sequence[Bundle], turn: int) -> list[Bundle]:
    start = turn % len(bundles)
    return [*bundles[start:], *bundles[:start]]


def _summary(values: list[float]) -> dict[str, float]:
    low, median, high = np.percentile(values, [10, 50, 90])
    return {
        "median_ms": float(median),
        "low_ms": float(low),
        "high_ms": float(high),
        "runs": len(values),
    }
