"""tokt's texture model for what is not scored: to be timed, or to judge other pictures."""

from __future__ import annotations

from dataclasses import dataclass

from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.studies.speed.models import (
    LABEL_EVERY,
    TrainingExamples,
    examples_from_labels,
    fit_extractor_pair,
)
from tokt.studies.speed.models import examples_from_two_images as two_images
from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.fitting.presets import DEFAULT_EXTRACTOR, extractor_for

_PRESET = "best"


@dataclass(frozen=True)
class ToktModel:
    """A texture model that learnt from all it may.

    Parameters
    ----------
    bundle : Bundle
    words : str
        What it learnt from. Its figures on frames of the mission would not be held out.
    """

    bundle: Bundle
    words: str


def tokt_model(inputs: StudyInputs) -> ToktModel:
    """The bundle of the request; otherwise the preset ``best`` on the mission's labels.

    Without labels it learns from the thesis's kind of images, an early frame and a texture.
    """
    if inputs.request.model is not None:
        bundle = read_bundle(str(inputs.request.model))
        return ToktModel(bundle, f"the model {bundle.label} as given")
    examples = _examples(inputs)
    golden = inputs.any_left()
    extractor = extractor_for(DEFAULT_EXTRACTOR, _PRESET)
    models = fit_extractor_pair(_PRESET, extractor, examples, golden)
    return ToktModel(models.bundle, f"the features of preset {_PRESET}, {examples.words}")


def _examples(inputs: StudyInputs) -> TrainingExamples:
    if inputs.labels:
        try:
            return examples_from_labels(inputs.mission, inputs.labels, inputs.taxonomy)
        except ToktError as error:
            inputs.say(f"no model from every {LABEL_EVERY}th labelled frame: {error}")
    return two_images(inputs.mission)
