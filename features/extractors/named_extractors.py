"""The named extractors, joins of them by ``+``, and extractors from spec files."""

import json
from dataclasses import replace
from pathlib import Path

from tokt.features.common.errors import ToktError, naming, os_errors_as
from tokt.features.kernels.quantization import FRAME, Quantization

from .spec import build_extractor
from .textures import LOG, NEAREST, Context, Extractor, Glcm, Half, Join, Lbp, Lines, Structure
from .water import Colour, Gradients, PatchPlace, Relative, WaterContrast

_FILE = "spec:"

# Chosen by blocked cross-validation on the sea-trial mission, as CHOSEN_ON of the presets says.
_GRAINS = Quantization(gain=8, smooth=3, window=121, by=FRAME)
_PATTERNS = Quantization(gain=8, smooth=5, window=61, by=FRAME)
_STROKES = Quantization(gain=24, smooth=3, window=31, by=FRAME)

_SHAPES = Lbp(8, 13, "frame", _PATTERNS, NEAREST)
_FINE_LINES = Lines((2, 4), replace(_STROKES, smooth=1))
_GRADIENTS = Gradients((1, 3, 5, 9))
# For half the width; chosen as CHOSEN_ON of the presets says.
_LITE_LINES = Lines((2, 4, 8, 16), replace(_STROKES, smooth=1, window=15))
_LITE_SHAPES = Lbp(8, 6, "frame", replace(_PATTERNS, smooth=3, window=31), NEAREST)
_LITE_GRADIENTS = Gradients((1, 3))
NAMED: dict[str, Extractor] = {
    "lbp": Lbp(10, 5, "patch"),
    "lbp_10_5": Lbp(10, 5, "patch"),
    "lbp_24_8": Lbp(24, 8, "patch"),
    "lbp_10_5_frame": Lbp(10, 5, "frame"),
    "lbp_24_8_frame": Lbp(24, 8, "frame"),
    "haralick": Glcm(ignore_zeros=False),
    "haralick_flat": Glcm(ignore_zeros=False, image=replace(_GRAINS, levels=64), scale=LOG),
    "lbp_flat_8_5": Lbp(8, 5, "frame", _PATTERNS, NEAREST),
    "lbp_flat_8_9": Lbp(8, 9, "frame", _PATTERNS, NEAREST),
    "lbp_flat_8_13": _SHAPES,
    "lines": Lines((8, 16, 32), _STROKES),
    "lines_fine": _FINE_LINES,
    "structure_3": Structure(_GRAINS),
    "structure_7": Structure(Quantization(gain=24, smooth=7, window=121, by=FRAME)),
    "structure_11": Structure(Quantization(gain=24, smooth=11, window=121, by=FRAME)),
    "water": WaterContrast([_GRADIENTS, Colour(9, gray=True), _SHAPES, _FINE_LINES], 0.3, 9),
    "water_gray": Join(
        [Context(Relative([_GRADIENTS, _SHAPES, _FINE_LINES], 0.3), "mean"), PatchPlace()]
    ),
    "lite": Half(Context(_LITE_LINES, "mean")),
    "lite_water": Half(
        WaterContrast([_LITE_GRADIENTS, Colour(3, gray=True), _LITE_SHAPES], 0.3, 3)
    ),
    "lite_water_gray": Half(
        Join([Context(Relative([_LITE_GRADIENTS, _LITE_SHAPES], 0.3), "mean"), PatchPlace()])
    ),
    "lbp_8_1": Lbp(8, 1, "patch"),
    "lbp_8_2": Lbp(8, 2, "patch"),
    "lbp_12_3": Lbp(12, 3, "patch"),
    "haralick_log": Glcm(ignore_zeros=False, scale=LOG),
    "haralick_log_64": Glcm(ignore_zeros=False, image=Quantization(gain=1, levels=64), scale=LOG),
    "haralick_log_16": Glcm(ignore_zeros=False, image=Quantization(gain=1, levels=16), scale=LOG),
}


def extractor_named(text: str) -> Extractor:
    """The extractor behind a name, behind several joined by ``+``, or in a file.

    Examples
    --------
    >>> extractor_named("haralick+lbp_24_8_frame").dim
    39

    Raises
    ------
    ToktError
        If a name is not known, or ``spec:FILE`` is not a file with an extractor's JSON spec.
    """
    if text.startswith(_FILE):
        return _from_file(Path(text.removeprefix(_FILE)))
    parts: list[Extractor] = []
    for name in text.split("+"):
        if name not in NAMED:
            raise ToktError(
                f"unknown extractor {name!r} (known: {', '.join(NAMED)}; join with +; "
                f"or {_FILE}FILE.json)"
            )
        named = NAMED[name]
        parts += named.parts if type(named) is Join else [named]
    return parts[0] if len(parts) == 1 else Join(parts)


def _from_file(path: Path) -> Extractor:
    try:
        with os_errors_as(str(path)):
            spec = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ToktError(f"{path}: not JSON ({str(error).splitlines()[0]})") from None
    with naming(path):
        return build_extractor(spec)
