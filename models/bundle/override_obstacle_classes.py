"""Overriding, when a model is shipped, which of its classes are obstacles."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tokt.features.common.errors import ToktError
from tokt.models.operating_point import OperatingPoint
from tokt.models.sight import sight_to_json

from .bundle import Bundle, BundleContent, bundle_bytes, bundle_from_bytes, classes_json
from .card import model_card

PROVENANCE_KEY = "obstacle_flags"
_VOID = (
    "Which classes are obstacles was changed after training. Figures of obstacle patches and of "
    "frames do not hold, nor does the operating point; they were left out."
)
_OF_STATUSES = ("frames", "frames_at_zero", "fold_rules", "stress", "right_by_margin")
_OBSTACLE_FIGURES = ("precision", "recall", "f1", "average_precision")


def override_obstacle_classes(
    bundle: Bundle, flags: Mapping[str, bool], taxonomy: str, sha256: str
) -> Bundle:
    """The same model with other obstacle flags; the same bundle where none differs.

    `flags` may have other classes than the model's. `taxonomy` and `sha256` are the name and hash
    of the file that says so, for the provenance.

    Raises ToktError if the model has one output only, a class of it has no flag, or the flags leave
    it nothing to tell apart.
    """
    model = bundle.model
    if len(model.bias) == 1:
        raise ToktError(
            f"model {bundle.label} tells {model.classes[0]} from {model.classes[1]} and nothing "
            "else: training fixed which side is the obstacle. A model of --task classes can be "
            "shipped with other flags"
        )
    missing = [name for name in model.classes if name not in flags]
    if missing:
        lacks = f"taxonomy {taxonomy} has no class {', '.join(missing)}"
        raise ToktError(f"{lacks}, which model {bundle.label} tells apart")
    changed = {
        name: flags[name]
        for name, was in zip(model.classes, model.obstacle, strict=True)
        if flags[name] != was
    }
    if not changed:
        return bundle
    anew = replace(model, obstacle=tuple(flags[name] for name in model.classes))
    golden = bundle.golden
    obstacle = np.stack([anew.obstacle_patches(values) for values in golden.decision_values])
    source = {"taxonomy": taxonomy, "sha256": sha256, "changed": changed, "was": bundle.sha256}
    content = replace(
        bundle.content,
        model=anew,
        golden=replace(golden, obstacle=obstacle),
        operating_point=OperatingPoint(chosen={"void": _VOID}),
        metrics=_left(bundle.metrics),
        provenance={**bundle.provenance, PROVENANCE_KEY: source},
    )
    found = bundle_from_bytes(bundle_bytes(_with_card(content)), f"model {bundle.label}")
    if found.deployment_fault:
        what = f"model {bundle.label} with the obstacles of {taxonomy}"
        raise ToktError(f"{what}: {found.deployment_fault}")
    return found


def _left(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The figures that do not depend on which classes are obstacles."""
    left = {key: value for key, value in metrics.items() if key not in _OF_STATUSES}
    patch = {**metrics.get("patch", {}), **dict.fromkeys(_OBSTACLE_FIGURES)}
    return {**left, "patch": patch, "folds": [], "voided": _VOID}


def _with_card(content: BundleContent) -> BundleContent:
    recipe = {
        "extractor": content.extractor_spec,
        "extractor_name": content.provenance.get("extractor_name"),
        "dim": content.model.dim,
        "grid": content.grid.to_json(),
        "classes": classes_json(content.model),
        "thresholds": content.model.thresholds.tolist(),
        "landmarks": content.model.landmarks,
        "metrics": content.metrics,
        "operating_point": content.operating_point.to_json(),
        "distribution": content.distribution.summary() if content.distribution else None,
        "sight": sight_to_json(content.sight),
    }
    label = f"{content.name}/{content.version}"
    return replace(content, card=model_card(label, recipe, content.provenance))
