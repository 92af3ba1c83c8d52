"""Extractors built from JSON specs, whole or not at all, and specs summed up in one line."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from tokt.features.common.errors import ToktError, naming
from tokt.features.kernels.checks import check_samples
from tokt.features.kernels.quantization import Quantization

from .textures import (
    BILINEAR,
    LINEAR,
    LOG,
    NEAREST,
    PLAIN_IMAGE,
    STATISTICS,
    Context,
    Extractor,
    Glcm,
    Half,
    Join,
    Lbp,
    Lines,
    Moments,
    Structure,
)
from .water import Colour, Gradients, PatchPlace, Relative, WaterContrast

Spec = Mapping[str, Any]
Outer = frozenset[str]


def _image_from(spec: Spec) -> Quantization | None:
    if spec["image"] == PLAIN_IMAGE:
        return None
    with naming(f"extractor {spec['name']}"):
        return Quantization.from_json(spec["image"])


def _lbp_from(spec: Spec, outer: Outer) -> Lbp:
    points, radius, border = spec["points"], spec["radius"], spec["border"]
    if "sampling" in spec and spec["sampling"] not in (BILINEAR, NEAREST):
        raise ToktError(f"lbp: sampling is '{BILINEAR}' or '{NEAREST}', not {spec['sampling']!r}")
    if type(points) is not int or type(radius) is not int:
        raise ToktError(f"lbp: points and radius are whole numbers, not {points!r}, {radius!r}")
    if not 4 <= points <= 64 or not 1 <= radius <= 32:
        raise ToktError(f"lbp: {points} points at radius {radius} is out of range (4-64, 1-32)")
    if border not in ("patch", "frame"):
        raise ToktError(f"lbp: border is 'patch' or 'frame', not {border!r}")
    return Lbp(points, radius, border, _image_from(spec), spec.get("sampling"))


def _haralick_from(spec: Spec, outer: Outer) -> Glcm:
    if "scale" in spec and spec["scale"] not in (LINEAR, LOG):
        raise ToktError(f"haralick: scale is '{LINEAR}' or '{LOG}', not {spec['scale']!r}")
    if type(spec["ignore_zeros"]) is not bool:
        raise ToktError("haralick: ignore_zeros is true or false")
    return Glcm(spec["ignore_zeros"], _image_from(spec), spec.get("scale"))


def _lines_from(spec: Spec, outer: Outer) -> Lines:
    samples = spec["samples"]
    try:
        if not isinstance(samples, list):
            raise ValueError("samples is a list")
        check_samples(samples, 0)
    except ValueError as error:
        raise ToktError(f"lines: {error}") from None
    return Lines(samples, _image_from(spec))


def _context_from(spec: Spec, outer: Outer) -> Context:
    statistic = spec["statistic"]
    if not isinstance(statistic, str) or statistic not in STATISTICS:
        raise ToktError(f"context: statistic is one of {', '.join(STATISTICS)}, not {statistic!r}")
    return Context(_built(spec["part"], outer | {"context"}), statistic)


def _join_from(spec: Spec, outer: Outer) -> Join:
    parts = spec["parts"]
    if not isinstance(parts, list) or len(parts) < 2:
        raise ToktError("extractor join: takes two or more other extractors")
    return Join([_built(part, outer | {"join"}) for part in parts])


MAX_SMOOTH, MAX_CELLS = 15, 32


def _gradients_from(spec: Spec, outer: Outer) -> Gradients:
    smooth, known = spec["smooth"], range(1, MAX_SMOOTH + 1, 2)
    sound = isinstance(smooth, list) and all(type(n) is int and n in known for n in smooth)
    if not (sound and smooth and smooth == sorted(set(smooth))):
        raise ToktError(f"gradients: smooth is rising odd numbers up to {MAX_SMOOTH}")
    return Gradients(smooth)


def _colour_from(spec: Spec, outer: Outer) -> Colour:
    if type(spec["cells"]) is not int or not 3 <= spec["cells"] <= MAX_CELLS:
        raise ToktError(f"colour: cells is a whole number, 3 to {MAX_CELLS}")
    if spec.get("gray", True) is not True:
        raise ToktError("colour: gray is true, or not there")
    return Colour(spec["cells"], gray="gray" in spec)


def _parts_with_energies(spec: Spec, outer: Outer) -> list[Extractor]:
    """The parts of what takes the water's features away, and with them a sound `quietest`."""
    name, parts, quietest = spec["name"], spec["parts"], spec["quietest"]
    if not isinstance(parts, list) or not parts:
        raise ToktError(f"extractor {name}: takes one other extractor or more")
    if type(quietest) is not float or not 0 < quietest <= 1:
        raise ToktError(f"{name}: quietest is above 0.0 and at most 1.0, not {quietest!r}")
    built = [_built(part, outer | {"relative", "water_contrast"}) for part in parts]
    if not any(flag for part in built for flag in part.energies):
        raise ToktError(f"extractor {name}: one of its parts is gradients or colour")
    return built


def _relative_from(spec: Spec, outer: Outer) -> Relative:
    return Relative(_parts_with_energies(spec, outer), spec["quietest"])


def _water_contrast_from(spec: Spec, outer: Outer) -> WaterContrast:
    cells = spec["cells"]
    if type(cells) is not int or cells % 3 or not 3 <= cells <= MAX_CELLS:
        raise ToktError(f"water_contrast: cells is a multiple of 3, 3 to {MAX_CELLS}")
    return WaterContrast(_parts_with_energies(spec, outer), spec["quietest"], cells)


# By version, the builder and the keys beside name and version; no other key comes to a builder.
_BUILDERS: dict[str, dict[int, tuple[Callable[[Spec, Outer], Extractor], set[str]]]] = {
    "lbp": {
        1: (_lbp_from, {"points", "radius", "border", "image"}),
        2: (_lbp_from, {"points", "radius", "border", "sampling", "image"}),
    },
    "haralick": {
        1: (_haralick_from, {"ignore_zeros", "image"}),
        2: (_haralick_from, {"ignore_zeros", "scale", "image"}),
    },
    "moments": {1: (lambda spec, outer: Moments(_image_from(spec)), {"image"})},
    "structure": {1: (lambda spec, outer: Structure(_image_from(spec)), {"image"})},
    "lines": {1: (_lines_from, {"samples", "image"})},
    "gradients": {1: (_gradients_from, {"smooth"})},
    "colour": {1: (_colour_from, {"cells"}), 2: (_colour_from, {"cells", "gray"})},
    "place": {1: (lambda spec, outer: PatchPlace(), set())},
    "relative": {1: (_relative_from, {"parts", "quietest"})},
    "water_contrast": {1: (_water_contrast_from, {"parts", "quietest", "cells"})},
    "context": {1: (_context_from, {"part", "statistic"})},
    "join": {1: (_join_from, {"parts"})},
    "half": {1: (lambda spec, outer: Half(_built(spec["part"], outer | {"half"})), {"part"})},
}


def _built(spec: Any, outer: Outer) -> Extractor:
    """Build what a spec describes that stands inside others of the names in `outer`."""
    if not isinstance(spec, Mapping):
        raise ToktError(f"an extractor's spec is an object, not {type(spec).__name__}")
    name, version = spec.get("name"), spec.get("version")
    if not isinstance(name, str) or name not in _BUILDERS:
        raise ToktError(f"unknown extractor {name!r} (known: {', '.join(_BUILDERS)})")
    if name in outer:
        raise ToktError(f"extractor {name}: cannot stand inside another {name}")
    if type(version) is not int or version not in _BUILDERS[name]:
        raise ToktError(f"extractor {name}: version {version!r} is not known here")
    builder, keys = _BUILDERS[name][version]
    if set(spec) != keys | {"name", "version"}:
        wrong = ", ".join(sorted(map(str, set(spec) ^ (keys | {"name", "version"}))))
        raise ToktError(f"extractor {name}: unknown or missing in its spec: {wrong}")
    return builder(spec, outer)


def build_extractor(spec: Spec) -> Extractor:
    """Build the extractor a spec describes.

    Raises ToktError if the spec names an extractor, version or option this tokt does not know. A
    spec is never read with a part of it ignored.
    """
    return _built(spec, frozenset())


_BORDERS = {"patch": "within each patch", "frame": "across patch edges"}
_FIXED_WORDS = {
    "moments": "moments and percentiles of the grey levels",
    "structure": "strength and coherence of edges",
    "colour": "colour (CIELAB) and its changes",
    "place": "place in the frame",
}


def extractor_summary(spec: Mapping[str, Any]) -> str:
    """Say what an extractor computes, of which picture; of an unknown one, its JSON."""
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
        case "lines":
            return f"lines of {', '.join(map(str, part['samples']))} samples"
        case "context":
            around = f"of each patch and the {part['statistic']} of its neighbours"
            return f"{extractor_summary(part['part'])}, {around}"
        case "half":
            return f"{extractor_summary(part['part'])}, at half the width"
        case "gradients":
            return f"gradients smoothed over {', '.join(map(str, part['smooth']))} pixels"
        case "relative" | "water_contrast":
            of = extractor_summary({"name": "join", "parts": part["parts"]})
            less = f"{of}, less what the quietest {part['quietest']:.0%} of its patches show"
            more = (
                "; neighbours, colour off a smooth field and off a plane, the frame's own energies"
            )
            return f"{less}{more}" if part["name"] == "water_contrast" else less
    return _FIXED_WORDS.get(str(part.get("name"))) or json.dumps(dict(part), sort_keys=True)


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
