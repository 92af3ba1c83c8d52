"""Everything that is said of some models, as one JSON object."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ... import __version__
from ...features.errors import ToktError
from ..presets import PRESETS
from .errors import errors_by_stretch, words_on_stretches, worst_errors
from .explorer import explorer_data
from .judged import HELD_OUT, Contender, Judged
from .learning import learning_curve
from .pairs import compare_pairs, main_measure
from .timing import measure_times

FORMAT_VERSION = 1


def _model(
    judged: Judged, contender: Contender, pairs: dict[str, Any], times: dict[str, Any]
) -> dict[str, Any]:
    bundle = contender.bundle
    provenance = bundle.content.provenance
    return {
        "model": contender.label,
        "sha256": bundle.sha256,
        "preset": provenance.get("preset"),
        "dataset": provenance.get("dataset"),
        "features": bundle.extractor.dim,
        "bundle_bytes": len(bundle.data),
        "split": contender.split,
        "rule": contender.rule.to_json(),
        "rule_words": contender.rule.words(),
        "operating_point_words": bundle.operating_point.chosen.get("words"),
        "fold_rules": None
        if contender.fold_rules is None
        else [rule.words() for rule in contender.fold_rules],
        "latency_frames": contender.rule.latency_frames,
        "latency_words": contender.rule.latency_words(),
        **judged.figures(contender),
        "intervals": pairs["intervals"][contender.label],
        "time": times["models"][contender.label],
    }


def _ranked(models: list[dict[str, Any]], measure: str) -> list[str]:
    """The best first; equal ones as they were given."""
    return [row["model"] for row in sorted(models, key=lambda row: -(row["patch"][measure] or 0.0))]


def _learns(contender: Contender) -> bool:
    """Whether a model learns from the dataset's labels; the thesis's learn from two images."""
    preset = str(contender.bundle.content.provenance.get("preset"))
    return preset not in PRESETS or not PRESETS[preset].two_images


def _asked_for(judged: Judged, wanted: str) -> str:
    """The model whose learning curve is asked for, by ``name`` or ``name/version``.

    Raises
    ------
    ToktError
        If it is not one of those compared, or has no learning curve.
    """
    for item in judged.contenders:
        if wanted in (item.label, item.bundle.name):
            if not _learns(item):
                raise ToktError(f"--learning-curve {wanted}: it learns from two images alone")
            return item.label
    raise ToktError(f"--learning-curve {wanted}: not one of the models that are compared")


def _learning(
    judged: Judged, ranked: list[str], workspace: Path, progress: Callable[..., Any]
) -> dict[str, Any]:
    """The learning curve of the first that has one, or why there is none."""
    if judged.mode != HELD_OUT:
        return {"missing": "Leave --mission out for it: it is of the dataset's own folds."}
    if judged.dataset is None:
        return {"missing": "The dataset is not in this workspace."}
    by_label = {item.label: item for item in judged.contenders}
    for label in ranked:
        if _learns(by_label[label]):
            return learning_curve(by_label[label], judged.dataset, workspace, progress)
    return {"missing": "These models learn from two images alone, not from labels."}


def compare_models(
    judged: Judged, workspace: Path, progress: Callable[..., Any], curve_of: str | None = None
) -> dict[str, Any]:
    """Compare models on what `judged` holds.

    Parameters
    ----------
    judged : Judged
    workspace : Path
        Holds the features that the learning curve needs.
    progress : callable
    curve_of : str, optional
        Name of the model to draw the learning curve of; by default the best.

    Returns
    -------
    dict
        JSON: models, pairs, words, stretches, errors, learning_curve, explorer, and how each
        figure came about.

    Raises
    ------
    ToktError
        If `curve_of` is not one of the models, or has no learning curve.
    """
    asked_for = [] if curve_of is None else [_asked_for(judged, curve_of)]
    pairs = compare_pairs(judged)
    times = measure_times(judged)
    models = [_model(judged, item, pairs, times) for item in judged.contenders]
    ranked = _ranked(models, main_measure(judged).name)
    stretches = errors_by_stretch(judged)
    return {
        "format_version": FORMAT_VERSION,
        "tokt": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "mode": judged.mode,
        "what": judged.what,
        "notes": judged.notes,
        "patches": len(judged.truth),
        "obstacle_patches": int(judged.truth.sum()),
        "unit": judged.unit,
        "words": [pair["words"] for pair in pairs["pairs"]] or [pairs["method"]],
        "models": models,
        "ranking": ranked,
        **{key: pairs[key] for key in ("measure", "measure_title", "blocks", "pairs", "method")},
        "times": {key: times[key] for key in ("how", "kernels", "cpu")},
        "stretches": stretches,
        "stretch_words": [words_on_stretches(label, stretches) for label in ranked]
        if stretches
        else [],
        "errors": worst_errors(judged),
        "learning_curve": _learning(judged, asked_for or ranked, workspace, progress),
        "explorer": explorer_data(judged) if judged.has_frames and judged.two_sided else None,
    }
