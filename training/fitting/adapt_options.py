"""AdaptOptions, and the adaptation of a model to a new dive that they describe."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.labels.formats.options import no_progress
from tokt.labels.record import NoLabelsError
from tokt.models.registry.registry import Registry
from tokt.models.signing.passphrase import signing_key
from tokt.training.datasets.dataset import DatasetPlan, DatasetVersion, write_dataset
from tokt.training.datasets.labelled_missions import labelled_missions
from tokt.training.datasets.mission_source import plan_from_missions, plan_with
from tokt.training.options import Notice, OneOrMore, PathOrText, Progress, paths, takes

from .adapt import adaptation, adapted_request, known_model
from .presets import preset_for
from .tracking import log_adaptation, log_and_register
from .train import fit_and_measure
from .train_options import TrainedVersion


@dataclass(frozen=True)
class AdaptOptions:
    """The options of ``tokt adapt``.

    Parameters
    ----------
    model : str
        ``NAME``, ``NAME@ALIAS`` or ``NAME/VERSION``.
    mission : path
        The new dive: a folder or video, ``NAME=DIR`` where its labels call it otherwise.
    labels : path, or several
        Label files; by default the workspace's label store.
    draws : int
        Orders of labelled frames, drawn by lot, in the learning curve.
    output : path
        HTML report to write.
    split, site, jobs, sign, workspace
        As in `TrainOptions`; by default the split is the model's.
    """

    model: str
    mission: PathOrText
    labels: OneOrMore = None
    draws: int = 5
    output: PathOrText | None = None
    split: str | None = None
    site: Sequence[str] | None = None
    jobs: int = -1
    sign: PathOrText | None = None
    workspace: PathOrText = Path(".tokt")


@takes(AdaptOptions)
def adapt(
    options: AdaptOptions, *, progress: Progress = no_progress, notice: Notice = warnings.warn
) -> tuple[TrainedVersion, dict[str, Any]]:
    """Train a model's next version on a new dive too; find what that gains, and costs elsewhere.

    Parameters
    ----------
    options : AdaptOptions
        Or its fields.
    progress, notice : callable, optional
        As for `build_dataset`.

    Returns
    -------
    version : TrainedVersion
    found : dict
        The learning curve, what is gained on the new dive, and what is lost on the others.

    Raises
    ------
    ToktError
        If the model, the dive, its labels or an option cannot be used.

    Examples
    --------
    >>> version, found = tokt.adapt("tower-lbp@champion", "dive7")  # doctest: +SKIP
    """
    workspace = Path(options.workspace)
    registry, root, cache = Registry(workspace), workspace / "datasets", workspace / "cache"
    known, key = known_model(registry, options.model, root), signing_key(options.sign)
    try:
        name, plan = _new_dive(options, known.dataset, notice)
    except NoLabelsError as error:
        raise ToktError(
            f"{error}; label 5 to 10 of its frames: tokt label {options.mission} --model "
            f"{options.model} (key q leads to the next one that the model is unsure of)"
        ) from None
    base, preset = known.dataset, known.settings.preset
    data = write_dataset(plan_with(base, plan), root, progress)
    if preset_for(preset, data) != preset:
        notice(
            f"note: {known.bundle.label} was made for one dive's water, and its features stay; "
            f"tokt train {base.name} makes a model for several"
        )
    request = adapted_request(known, data, options.split, options.site or ())
    trained = fit_and_measure(request, cache, progress, options.jobs)
    found = adaptation(known, trained, name, cache, progress, options.draws, options.jobs)
    version = log_and_register(trained, registry, key)
    page = log_adaptation(found, version, registry)
    if options.output:
        atomic.write_text(Path(options.output), page)
    return TrainedVersion(version, trained, workspace), found


def _new_dive(
    options: AdaptOptions, base: DatasetVersion, notice: Notice
) -> tuple[str, DatasetPlan]:
    """The dive's name, and its labelled frames as a plan."""
    mission, labels = paths(options.mission), paths(options.labels)
    missions = labelled_missions(
        *(mission, labels, Path(options.workspace), base.taxonomy, base.grid, notice)
    )
    if len(missions) > 1:
        raise ToktError("adapt takes one new dive at a time")
    plan, remarks = plan_from_missions(
        *(base.name, base.task, missions, base.taxonomy, base.grid),
        block_frames=base.block_frames or 1,
    )
    if not plan.frames:
        raise NoLabelsError(f"no patch of mission {missions[0].name!r} has a sure label")
    for remark in remarks:
        notice(f"note: {remark}")
    return missions[0].name, plan
