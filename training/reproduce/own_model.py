"""A model of our own for what is not scored: to time it, or to judge other pictures with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...features.errors import ToktError
from ...models.bundle import Bundle, read_bundle
from ..bench.models import LABEL_EVERY, Lesson, learn_features, lesson_from_labels
from ..bench.models import lesson_from_two_images as two_images
from ..presets import DEFAULT_EXTRACTOR, extractor_for

if TYPE_CHECKING:
    from .material import Material

_PRESET = "best"


@dataclass(frozen=True)
class OwnModel:
    """A texture model that learnt from all it may.

    Parameters
    ----------
    bundle : Bundle
    words : str
        What it learnt from. Its figures on frames of the mission would not be held out.
    """

    bundle: Bundle
    words: str


def own_model(material: Material) -> OwnModel:
    """The bundle of the request; otherwise the preset ``best`` on the mission's labels.

    Without labels it learns from the thesis's kind of images, an early frame and a texture.
    """
    if material.request.model is not None:
        bundle = read_bundle(str(material.request.model))
        return OwnModel(bundle, f"the model {bundle.label} as given")
    lesson = _lesson(material)
    golden = material.any_left()
    extractor = extractor_for(DEFAULT_EXTRACTOR, _PRESET)
    models = learn_features(_PRESET, extractor, lesson, golden)
    return OwnModel(models.bundle, f"the features of preset {_PRESET}, {lesson.words}")


def _lesson(material: Material) -> Lesson:
    if material.labels:
        try:
            return lesson_from_labels(material.mission, material.labels, material.taxonomy)
        except ToktError as error:
            material.say(f"no model from every {LABEL_EVERY}th labelled frame: {error}")
    return two_images(material.mission)
