"""Figures of merit as lines for people."""

from __future__ import annotations

from typing import Any


def print_patches(patch: dict[str, Any]) -> None:
    """Obstacle figures where they mean something, and those by class for several classes."""
    if patch["f1"] is not None:
        print(
            f"  obstacle patches: F1 {figure(patch['f1'])}, precision "
            f"{figure(patch['precision'])}, recall {figure(patch['recall'])}, "
            f"AP {figure(patch['average_precision'])}"
        )
    if patch["f1"] is None or len(patch["per_class"]) > 2:
        by_class = ", ".join(
            f"{name} {figure(row['f1'])}" for name, row in patch["per_class"].items()
        )
        print(f"  classes: macro-F1 {figure(patch['macro_f1'])} ({by_class})")


def figure(value: float | None) -> str:
    """A figure with three decimals, or ``-`` where it is undefined."""
    return "-" if value is None else f"{value:.3f}"
