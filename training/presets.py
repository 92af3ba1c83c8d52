"""How a model is trained: the presets, as plain values that are logged with every run."""

from __future__ import annotations

from dataclasses import dataclass

from ..features.errors import ToktError
from ..features.extractor import Extractor, Haralick, extractor_named


@dataclass(frozen=True)
class TrainingSettings:
    """What, beside the data, decides the weights.

    Parameters
    ----------
    preset : str
    scale : bool
        Whether features are brought to zero mean and unit variance.
    penalties : tuple of float
        Candidates for LinearSVC's C; with several, the choice is made by a blocked
        cross-validation inside the training part of each fold.
    two_images : bool
        Train on one ocean image against one other image, as the thesis does, not on the
        dataset.
    seed : int
        LinearSVC's random state.
    """

    preset: str
    scale: bool
    penalties: tuple[float, ...]
    two_images: bool
    seed: int = 42


PRESETS = {
    "thesis": TrainingSettings("thesis", scale=False, penalties=(100.0,), two_images=True),
    "plain": TrainingSettings(
        "plain", scale=True, penalties=(0.01, 0.1, 1.0, 10.0), two_images=False
    ),
    "best": TrainingSettings(
        "best", scale=True, penalties=(0.01, 0.1, 1.0, 10.0), two_images=False
    ),
}

CHOSEN_ON = (
    "The preset's features were chosen among joins of LBP and Haralick by blocked cross-validation "
    "on the sea-trial mission: figures on that mission are somewhat too good for it, and only "
    "another dive is a test."
)
_BEST = {
    "lbp": "lbp_24_8+lbp_24_8_frame",
    "haralick": "haralick+lbp_10_5_frame+lbp_24_8_frame",
}


def settings_named(preset: str) -> TrainingSettings:
    """The preset's settings. Raises ToktError if there is none of that name."""
    if preset not in PRESETS:
        raise ToktError(f"unknown preset {preset!r} (known: {', '.join(PRESETS)})")
    return PRESETS[preset]


def extractor_for(name: str, preset: str) -> Extractor:
    """The extractor a preset uses for ``lbp``, ``haralick`` or a more exact name.

    ``best`` widens the two plain names: ``lbp`` to LBP (24,8) with both border rules, and
    ``haralick`` to Haralick joined with LBP of the whole frame. ``thesis`` leaves grey level 0
    out of Haralick's counts, as the thesis does.
    """
    if preset == "best":
        return extractor_named(_BEST.get(name, name))
    if preset == "thesis" and name == "haralick":
        return Haralick(ignore_zeros=True)
    return extractor_named(name)
