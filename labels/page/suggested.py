"""A model's suggestions for one frame as pages get them."""

from __future__ import annotations

from typing import Any

from .session import Session

_DECIMALS = 4


def suggestions_of(session: Session, camera: str, frame: int) -> dict[str, Any] | None:
    """Suggested classes (indices into the model's) and margins by cell; None without a model."""
    if session.suggester is None:
        return None
    found = session.suggester.of(camera, frame)
    if found is None:
        return None
    # A page that was opened with another model must not take these for that one's.
    label = session.suggester.bundle.label
    if found.fault:
        return {"model": label, "classes": [], "values": [], "fault": found.fault}
    return {
        "model": label,
        "classes": found.classes.tolist(),
        "values": found.values.round(_DECIMALS).tolist(),
        "fault": "",
    }
