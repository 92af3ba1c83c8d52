"""Extractor specs summed up in one line, for model cards and reports."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from .base import PLAIN_IMAGE

_BORDERS = {"patch": "within each patch", "frame": "across patch edges"}


def extractor_summary(spec: Mapping[str, Any]) -> str:
    """Say what an extractor computes, of which picture.

    Parameters
    ----------
    spec : mapping
        As `Extractor.spec` gives it; of a name that is not known here, the JSON itself.
    """
    parts = spec["parts"] if spec.get("name") == "join" else [spec]
    by_picture: dict[str, list[str]] = {}
    for part in parts:
        by_picture.setdefault(_picture(part.get("image", PLAIN_IMAGE)), []).append(_texture(part))
    return "; ".join(f"{' + '.join(textures)}{on}" for on, textures in by_picture.items())


def _texture(part: Mapping[str, Any]) -> str:
    match part.get("name"):
        case "lbp":
            border = _BORDERS.get(str(part["border"]), str(part["border"]))
            nearest = " at the nearest pixels" if part.get("sampling") == "nearest" else ""
            return f"LBP ({part['points']},{part['radius']}){nearest} {border}"
        case "haralick":
            log = ", on a logarithmic scale" if part.get("scale") == "log" else ""
            return f"Haralick's 13 figures of grey-level co-occurrence{log}"
        case "moments":
            return "moments and percentiles of the grey levels"
        case "structure":
            return "strength and coherence of edges"
        case "lines":
            return f"lines of {', '.join(map(str, part['samples']))} samples"
        case "context":
            around = f"of each patch and the {part['statistic']} of its neighbours"
            return f"{extractor_summary(part['part'])}, {around}"
    return json.dumps(dict(part), sort_keys=True)


def _picture(image: Mapping[str, Any]) -> str:
    """How the picture is prepared; empty where it is the plain one."""
    if image == PLAIN_IMAGE:
        return ""
    flatten = image.get("flatten")
    done = []
    if isinstance(flatten, Mapping):
        done = [f"background of {flatten['window']} px taken away by {flatten['by']}"]
    done += [f"{key} {image[key]}" for key in ("smooth", "gain", "levels") if key in image]
    return f" on the picture below one grey level ({', '.join(done)})"
