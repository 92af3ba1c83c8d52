"""The weights of a model that version 0.1.0 registered, which kept them in a skops file alone.

Such a file is a zip of plain arrays and of a ``schema.json`` that says which is which. Only these
arrays are read: no class that the file names is looked up, so that nothing in it can run.
"""

import json
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import arrays_of, unzip

_ARRAYS = {"StandardScaler": ("mean_", "scale_"), "LinearSVC": ("coef_", "intercept_")}


def pipeline_arrays(data: bytes, where: str) -> dict[str, F64]:
    """``coef_`` and ``intercept_``, and ``mean_`` and ``scale_`` where features are scaled.

    ToktError if it is no skops file of such a pipeline.
    """
    members = unzip(data, where)
    try:
        places = _places(json.loads(members["schema.json"]))
        raw = {name: members[file] for name, file in places.items()}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ToktError(
            f"{where}: not a pipeline of a scaler and a LinearSVC, and nothing else is opened; "
            "train the model again, or use its .tokt file"
        ) from None
    return arrays_of(raw, dict.fromkeys(raw, np.float64), where)


def _places(schema: Any) -> dict[str, str]:
    """The member that each array lies in."""
    steps = [pair["content"][1] for pair in _fields(schema, "Pipeline")["steps"]["content"]]
    kinds = [step["__class__"] for step in steps]
    if kinds not in (["LinearSVC"], ["StandardScaler", "LinearSVC"]):
        raise ValueError("another pipeline")
    return {
        name: _fields(step, kind)[name]["file"]
        for kind, step in zip(kinds, steps, strict=True)
        for name in _ARRAYS[kind]
    }


def _fields(node: Any, kind: str) -> Any:
    if node["__class__"] != kind:
        raise ValueError(f"no {kind}")
    return node["content"]["content"]
