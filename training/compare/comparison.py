"""The whole comparison of some models, as one JSON object: figures, times, the explorer's data."""

import time
from base64 import b64encode
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt import __version__
from tokt.features.common.arrays import F64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.common.machine import machine
from tokt.features.frames.image_file import decode_image
from tokt.features.kernels.dispatch import KERNELS
from tokt.inference.policy.policy import judge_image
from tokt.models.operating_point import MofNRule
from tokt.training.fitting.presets import PRESETS

from .ceilings import ceilings
from .errors import errors_by_stretch, words_on_stretches, worst_errors
from .frames import OBSTACLE_FRAME, OCEAN
from .learning import learning_curve
from .pairs import compare_pairs
from .predictions import HELD_OUT, MISSION, ComparedModels, ModelPredictions

FORMAT_VERSION = 1
_TIMED_FRAMES = 10
_MIN_TIMED = 30
_SLIDER_STEPS = 250  # with the three that are added, a rank among them fits a byte
_SLIDER_TAIL = 0.005  # of the obstacles' scores on either side; the slider's ends


def _model(
    compared: ComparedModels,
    predictions: ModelPredictions,
    pairs: dict[str, Any],
    times: dict[str, Any],
) -> dict[str, Any]:
    bundle = predictions.bundle
    provenance = bundle.content.provenance
    return {
        "model": predictions.label,
        "sha256": bundle.sha256,
        "preset": provenance.get("preset"),
        "dataset": provenance.get("dataset"),
        "features": bundle.extractor.dim,
        "bundle_bytes": len(bundle.data),
        "split": predictions.split,
        "unseen": bundle.metrics.get("unseen") if compared.mode == HELD_OUT else None,
        "rule": predictions.rule.to_json(),
        "rule_words": predictions.rule.words(),
        "operating_point_words": bundle.operating_point.chosen.get("words"),
        "fold_rules": None
        if predictions.fold_rules is None
        else [rule.words() for rule in predictions.fold_rules],
        "latency_frames": predictions.rule.latency_frames,
        "latency_words": predictions.rule.latency_words(),
        **compared.figures(predictions),
        "intervals": pairs["intervals"][predictions.label],
        "time": times["models"][predictions.label],
    }


def _learns(predictions: ModelPredictions) -> bool:
    """Whether a model learns from the dataset's labels; the thesis's learn from two images."""
    preset = str(predictions.bundle.content.provenance.get("preset"))
    return preset not in PRESETS or not PRESETS[preset].two_images


def _asked_for(compared: ComparedModels, wanted: str) -> str:
    """The model whose learning curve is asked for, by ``name`` or ``name/version``."""
    for item in compared.models:
        if wanted in (item.label, item.bundle.name):
            if not _learns(item):
                raise ToktError(f"--learning-curve {wanted}: it learns from two images alone")
            return item.label
    raise ToktError(f"--learning-curve {wanted}: not one of the models that are compared")


def _learning(
    compared: ComparedModels, ranked: list[str], workspace: Path, progress: Callable[..., Any]
) -> dict[str, Any]:
    """The learning curve of the first that has one, or why there is none."""
    if compared.mode != HELD_OUT:
        return {"missing": "Leave --mission out for it: it is of the dataset's own folds."}
    if compared.dataset is None:
        return {"missing": "The dataset is not in this workspace, or there are several."}
    by_label = {item.label: item for item in compared.models}
    for label in ranked:
        if _learns(by_label[label]):
            return learning_curve(by_label[label], compared.dataset, workspace, progress)
    return {"missing": "These models learn from two images alone, not from labels."}


def compare_models(
    compared: ComparedModels,
    workspace: Path,
    progress: Callable[..., Any],
    curve_of: str | None = None,
    with_ceilings: bool = False,
) -> dict[str, Any]:
    """Compare models on what `compared` holds.

    The workspace holds the features that the learning curve needs. That is of the model named
    `curve_of`, by default of the best. `with_ceilings` tries learners that are never deployed on
    what was held out.

    Returns JSON: models, pairs, words, stretches, errors, learning_curve, ceilings, explorer, and
    how each figure came about. Raises ToktError if `curve_of` is not one of the models, or has no
    learning curve.
    """
    asked_for = [] if curve_of is None else [_asked_for(compared, curve_of)]
    pairs = compare_pairs(compared)
    times = measure_times(compared)
    models = [_model(compared, item, pairs, times) for item in compared.models]
    # The best first; equal ones as they were given.
    best_first = sorted(models, key=lambda row: -(row["patch"][pairs["measure"]] or 0.0))
    ranked = [row["model"] for row in best_first]
    stretches = errors_by_stretch(compared)
    learning = [item for item in compared.models if _learns(item)]
    return {
        "format_version": FORMAT_VERSION,
        "tokt": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "mode": compared.mode,
        "what": compared.what,
        "notes": compared.notes,
        "patches": len(compared.truth),
        "obstacle_patches": int(compared.truth.sum()),
        "unit": compared.unit,
        "words": [pair["words"] for pair in pairs["pairs"]] or [pairs["method"]],
        "models": models,
        "ranking": ranked,
        **{key: pairs[key] for key in ("measure", "measure_title", "blocks", "pairs", "method")},
        "times": {key: times[key] for key in ("how", "kernels", "cpu")},
        "stretches": stretches,
        "stretch_words": [words_on_stretches(label, stretches) for label in ranked]
        if stretches
        else [],
        "errors": worst_errors(compared),
        "learning_curve": _learning(compared, asked_for or ranked, workspace, progress),
        "ceilings": ceilings(compared, learning, workspace, progress) if with_ceilings else [],
        "explorer": explorer_data(compared) if compared.has_frames and compared.two_sided else None,
    }


def _pictures(compared: ComparedModels) -> tuple[list[U8], str]:
    """Some frames for all models alike."""
    if compared.mode == MISSION and compared.read_frame is not None:
        table = compared.series.table
        rows = np.unique(np.linspace(0, len(table) - 1, _TIMED_FRAMES).round().astype(int))
        keys = table.loc[rows, ["mission", "camera", "frame"]].itertuples(index=False, name=None)
        pictures = [one for key in keys if (one := compared.read_frame(*key)) is not None]
        return pictures, f"{len(pictures)} frames of the mission"
    golden = compared.models[0].bundle.content.golden.frames
    what = "1 golden frame" if len(golden) == 1 else f"{len(golden)} golden frames"
    return [decode_image(png, "golden frame") for png in golden], what


def measure_times(compared: ComparedModels) -> dict[str, Any]:
    """Time from a decoded frame to its verdict.

    Models take turns frame by frame, each beginning as often as the others, so that whatever else
    the machine does falls on all alike.

    Returns how (in words), kernels, cpu, and models: {label: {median_ms, low_ms, high_ms, runs}}
    with the 10th and the 90th percentile.
    """
    bundles = [predictions.bundle for predictions in compared.models]
    pictures, what = _pictures(compared)
    rounds = -(-_MIN_TIMED // len(pictures))
    spent: dict[str, list[float]] = {bundle.label: [] for bundle in bundles}
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for bundle in bundles:
            judge_image(bundle, pictures[0])
        for turn in range(rounds * len(pictures)):
            first = turn % len(bundles)
            for bundle in (*bundles[first:], *bundles[:first]):
                begun = time.perf_counter()
                judge_image(bundle, pictures[turn % len(pictures)])
                spent[bundle.label].append(1000 * (time.perf_counter() - begun))
    finally:
        cv2.setNumThreads(threads)
    return {
        "how": f"{what}, decoded frame to verdict, one thread, models taking turns",
        "kernels": KERNELS.name,
        "cpu": machine()["cpu"],
        "models": {
            label: {
                "median_ms": float(np.median(values)),
                "low_ms": float(np.percentile(values, 10)),
                "high_ms": float(np.percentile(values, 90)),
                "runs": len(values),
            }
            for label, values in spent.items()
        },
    }


def _thresholds(score: F64, truth: Bools, rule: MofNRule) -> F64:
    """The slider's steps, with 0 and the rule's margins among them.

    Close together around 0 and wide apart further out (evenly in asinh): some features give
    decision values in the hundreds, and what is decided is decided near 0.
    """
    looked_at = score[truth] if truth.any() else score
    low, high = np.quantile(looked_at, [_SLIDER_TAIL, 1 - _SLIDER_TAIL])
    scale = max(float(np.median(np.abs(looked_at))), 1e-6)
    first, last = np.arcsinh(
        [min(low, -0.2 * scale) / scale, max(high, 1.5 * rule.margin, scale) / scale]
    )
    steps = scale * np.sinh(np.linspace(float(first), float(last), _SLIDER_STEPS))
    now = [] if rule.instant_margin is None else [rule.instant_margin]
    return np.unique([*(float(f"{step:.4g}") for step in steps), 0.0, rule.margin, *now])


def _of_model(compared: ComparedModels, predictions: ModelPredictions) -> dict[str, Any]:
    thresholds = _thresholds(predictions.score, compared.truth, predictions.rule)
    sides = [np.sort(predictions.score[side]) for side in (compared.truth, ~compared.truth)]
    hit, false = (
        (len(side) - np.searchsorted(side, thresholds, side="right")).tolist() for side in sides
    )
    # A score exceeds thresholds[k] exactly where its rank exceeds k: nothing is rounded.
    ranks = np.searchsorted(thresholds, predictions.on_grid, side="left").astype(np.uint8)
    return {
        "thresholds": thresholds.tolist(),
        "true_positive": hit,
        "false_positive": false,
        "rule": predictions.rule.to_json(),
        "white": predictions.white,
        "patches": ranks.shape[1],
        "ranks": b64encode(ranks.tobytes()).decode("ascii"),
        "judged": predictions.judged.tolist(),
    }


def explorer_data(compared: ComparedModels) -> dict[str, Any]:
    """Counts and ranks from which the page finds every figure for any of its thresholds.

    They are obstacle, clear (patches), frames {number, ocean, obstacle, gap}, sequences {name,
    start, stop}, and models {label: {thresholds, true_positive, false_positive, rule, white,
    patches, ranks, judged}}: patches above each threshold, and for every patch of every frame
    (bytes in base64, `patches` a frame, row by row of the grid) how many thresholds its score
    exceeds, 0 where it has none. `white` is the fewest patches that a status takes.
    """
    table = compared.series.table
    named = [
        {
            "name": str(table.mission[rows.start])
            + ("" if table.camera[rows.start] == "left" else f" ({table.camera[rows.start]})"),
            "start": rows.start,
            "stop": rows.stop,
        }
        for rows in compared.series.sequences()
    ]
    return {
        "obstacle": int(compared.truth.sum()),
        "clear": int((~compared.truth).sum()),
        "frames": {
            "number": table.frame.tolist(),
            "ocean": compared.series.kind(OCEAN).tolist(),
            "obstacle": compared.series.kind(OBSTACLE_FRAME).tolist(),
            "gap": compared.series.gaps.tolist(),
        },
        "sequences": named,
        "models": {c.label: _of_model(compared, c) for c in compared.models},
    }
