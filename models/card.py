"""The model card: what a bundle is, for the person who has to trust it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def _figure(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return "; ".join(f"{name} {part}" for name, part in sorted(value.items()))
    return str(value)


def model_card(label: str, recipe: Mapping[str, Any], provenance: Mapping[str, Any]) -> str:
    """Markdown that follows from the recipe alone, so that it is the same at each export.

    Parameters
    ----------
    label : str
        ``name/version``.
    recipe : mapping
        As `Registry.recipe` gives it.
    provenance : mapping
        With the MLflow run id.
    """
    metrics = recipe["metrics"]
    patch = metrics["patch"]
    classes = ", ".join(
        f"{item['name']} ({'obstacle' if item['obstacle'] else 'clear'})"
        for item in recipe["classes"]
    )
    rows = [
        ("obstacle patches: F1", _figure(patch["f1"])),
        ("precision", _figure(patch["precision"])),
        ("recall", _figure(patch["recall"])),
        ("average precision", _figure(patch["average_precision"])),
        ("macro-F1 over the classes", _figure(patch["macro_f1"])),
        ("F1 of the folds", ", ".join(_figure(fold["f1"]) for fold in metrics["folds"])),
        (
            "open-ocean frames with a false status",
            f"{metrics['frames']['false_status']} of {metrics['frames']['ocean_frames']}",
        ),
    ]
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    origin = "\n".join(f"- {key}: {_text(value)}" for key, value in sorted(provenance.items()))
    return f"""# {label}

Tells patches of a frame apart: {classes}.

- extractor: `{recipe["extractor_name"]}`, {recipe["dim"]} features a patch
- grid: {recipe["grid"]["rows"]}x{recipe["grid"]["cols"]} patches, frames resized to width \
{recipe["grid"]["width"] or "as they are"}
- decision thresholds: {", ".join(str(value) for value in recipe["thresholds"])}

## What was measured

{metrics["split"]}

| figure | value |
|---|---|
{table}

## Where it comes from

{origin}

## Limits

Learnt from the missions named above and measured on them alone; another dive, lamp, camera or
water can differ much. The decision threshold is the classifier's own and has not been set for a
stated rate of false alarms. A verdict of clear means that no patch looked like what the model
learnt as an obstacle, not that there is none.
"""
