"""Bundles of the models that measurements make for themselves."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tests.models.parts import SEES_ALL, golden_of
from tokt.features.common.arrays import F64, I64, U8
from tokt.features.extractors.extractor import Extractor
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import BundleContent
from tokt.models.linear import LinearModel
from tokt.training.fitting.classifier import fit_classifier, linear_model
from tokt.training.fitting.presets import Hyperparameters, settings_named


def learnt(rows: F64, obstacle: I64) -> LinearModel:
    """A plain model of rows of features, and of which of them are an obstacle."""
    pipeline = fit_classifier(rows, obstacle, Hyperparameters(1.0), settings_named("plain"))
    return linear_model(pipeline, ("ocean", "other"), (False, True))


def content_of(
    name: str,
    extractor: Extractor,
    grid: Grid,
    model: LinearModel,
    shown: Sequence[U8],
    **more: Any,
) -> BundleContent:
    """What a bundle of a model holds that proves itself with the pictures shown."""
    values = [model.decision_values(extractor.describe(picture, grid)) for picture in shown]
    return BundleContent(
        *(name, "1", extractor.spec, grid, model),
        provenance={"made_by": "tests.load"},
        metrics={},
        golden=golden_of(shown, values, [model.obstacle_patches(one) for one in values]),
        trained_on=np.zeros(0, np.uint64),
        card="Made to measure; not to be deployed.\n",
        sight=(replace(SEES_ALL[0], darkest=0.0),),
        **more,
    )
