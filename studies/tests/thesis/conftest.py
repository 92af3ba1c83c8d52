"""What the tests of tokt reproduce share: one small rendered mission."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt_studies.thesis.exhibits.exhibit import StudyContext
from tokt_studies.thesis.exhibits.training_image_figures import described
from tokt_studies.thesis.inputs import ReproduceRequest
from tokt_studies.thesis.methods.curves import THESIS, Curves, Method
from tokt_studies.thesis.methods.mission_models import TOKT_TEXTURE

FRAMES = 16
"""Open water to frame 7, the tower from frame 8 on; nearest at 12."""


@pytest.fixture(scope="session")
def reproduce_mission(tmp_path_factory):
    """A rendered mission with labels and calibration; not to be changed."""
    folder = tmp_path_factory.mktemp("reproduce") / "dive"
    simulate_mission(folder, seed=1, n_frames=FRAMES, width=360, jobs=1)
    return folder


@pytest.fixture(scope="session")
def context_of(tmp_path_factory):
    """A context of a mission, in one process and with two frames for slow methods.

    What is in `given`, by property, is not computed; the rest are options of the request.
    """

    def make(
        mission: Path, given: Mapping[str, object] | None = None, **asked: object
    ) -> StudyContext:
        out = tmp_path_factory.mktemp("reproduced")
        request = ReproduceRequest(mission, out, sample=2, jobs=1, **asked)
        context = StudyContext(request, lambda line: None, lambda items, total, what: items)
        context.__dict__ |= given or {}
        return context

    return make


@pytest.fixture(scope="session")
def reproduced(reproduce_mission, context_of):
    """The rendered mission's context; not to be changed."""
    return context_of(reproduce_mission)


def _curves(context: StudyContext) -> Curves:
    """What `measure_curves` would give of the thesis's models; ours sees what is labelled."""
    patches: dict[str, dict[int, NDArray[np.bool_]]] = {key: {} for key in context.thesis}
    patches[TOKT_TEXTURE] = {}
    for number in context.scored:
        rows = described(context.left(number))
        for key, model in context.thesis.items():
            patches[key][number] = model.classifier.predict(rows[key]) == 1
        patches[TOKT_TEXTURE][number] = context.truth(number) == 1
    methods = {key: Method(model.title, THESIS, "") for key, model in context.thesis.items()}
    methods[TOKT_TEXTURE] = Method("ours", "tokt's", "held out")
    return Curves(pd.DataFrame(), pd.DataFrame(), methods, patches)


@pytest.fixture(scope="session")
def judged(reproduced, context_of):
    """What the exhibits share, with the thesis's models' judgements put in; not to be changed."""
    made = context_of(reproduced.mission.path)
    made.__dict__["curves"] = _curves(made)
    return made
