"""EvaluateOptions, the evaluation that they describe, and what options state of missions."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import parse_frames
from tokt.labels.formats.options import no_progress
from tokt.labels.taxonomy import load_taxonomy
from tokt.models.bundle.bundle import Bundle
from tokt.models.registry.load import load_model
from tokt.training.calibration_file import read_calibration_file
from tokt.training.datasets.labelled_missions import labelled_missions
from tokt.training.datasets.mission_source import LabelledMission
from tokt.training.options import Notice, OneOrMore, PathOrText, Progress, paths, takes

from .approaches import AtSea, logged_distances
from .evaluate import evaluate_missions, evaluate_patches


@dataclass(frozen=True, kw_only=True)
class MissionOptions:
    """The options of ``tokt evaluate`` and ``tokt compare`` that are of missions.

    Parameters
    ----------
    mission, labels, frames, taxonomy, workspace
        As in `DatasetOptions`.
    rate : float
        Frames a second of the missions.
    stopping_distance : float
        Metres in which the vehicle stops: each approach's first status is judged by it.
    calibration, log : path
        Where distances come from: the cameras' calibration, or the log of a run over the mission.
    """

    mission: OneOrMore = None
    labels: OneOrMore = None
    frames: str | None = None
    rate: float | None = None
    stopping_distance: float | None = None
    calibration: PathOrText | None = None
    log: PathOrText | None = None
    taxonomy: PathOrText | None = None
    workspace: PathOrText = Path(".tokt")

    @property
    def are_stated(self) -> bool:
        """Whether something is stated of missions, besides which they are."""
        at_sea = self.rate, self.stopping_distance, self.calibration, self.log
        return bool(self.labels or self.frames) or any(one is not None for one in at_sea)

    @property
    def numbers(self) -> list[int] | None:
        """The frames that are wanted; None for all."""
        return parse_frames(self.frames) if self.frames else None

    def at_sea(self, missions: Sequence[LabelledMission], notice: Notice) -> AtSea:
        """What was said of the missions; ToktError where it is of one mission alone."""
        for name, given in (("--frames", self.frames), ("--log", self.log)):
            if given and len(missions) > 1:
                raise ToktError(f"{name} goes with one mission")
        file = Path(self.calibration) if self.calibration else None
        rig = read_calibration_file(file, notice) if file else None
        distances = logged_distances(Path(self.log)) if self.log else {}
        return AtSea(self.rate, self.stopping_distance, rig, distances)


@dataclass(frozen=True)
class EvaluateOptions(MissionOptions):
    """The options of ``tokt evaluate``, with those of `MissionOptions`.

    Parameters
    ----------
    model : str or path
        As for `load_model`.
    patches : path
        Folder with one sub-folder of patch images a class, in place of missions.
    fixed_boundary : bool
        Leave the boundary between water and obstacles where it is, frame after frame.
    """

    model: PathOrText
    patches: PathOrText | None = None
    fixed_boundary: bool = False


@dataclass(frozen=True, repr=False)
class Evaluation:
    """What an evaluation found.

    Parameters
    ----------
    model : Bundle
        The model that was scored.
    figures : dict
        The JSON object of ``tokt evaluate --json``.
    """

    model: Bundle
    figures: dict[str, Any]

    def __repr__(self) -> str:
        patch = self.figures["patch"]
        f1 = "-" if patch["f1"] is None else f"{patch['f1']:.3f}"
        return f"{type(self).__name__}({self.model.label!r}: F1 {f1} of {patch['n']} patches)"


@takes(EvaluateOptions)
def evaluate(
    options: EvaluateOptions, *, progress: Progress = no_progress, notice: Notice = warnings.warn
) -> Evaluation:
    """Score a model on labelled missions, or on ready-cut patches.

    Parameters
    ----------
    options : EvaluateOptions
        Or its fields, as in the example.
    progress, notice : callable, optional
        As for `build_dataset`. A model that learnt from what it is scored on is told of.

    Returns
    -------
    Evaluation

    Raises
    ------
    ToktError
        If the model, a mission, its labels or an option cannot be used.

    Examples
    --------
    >>> found = tokt.evaluate("tower-lbp", mission="dive2", labels="dive2.csv")  # doctest: +SKIP
    >>> found.figures["frames"]["false_status"]  # doctest: +SKIP
    0
    """
    if bool(options.mission) == bool(options.patches):
        raise ToktError("give either --mission DIR or --patches DIR")
    if options.patches and options.are_stated:
        raise ToktError(
            "--patches has its labels in its folder names; --labels, --frames, --rate, "
            "--stopping-distance, --calibration and --log go with --mission"
        )
    workspace = Path(options.workspace)
    classes, wanted = load_taxonomy(workspace, *paths(options.taxonomy)), options.numbers
    bundle = load_model(options.model, workspace)
    if options.fixed_boundary:
        bundle = bundle.with_fixed_boundary()
    if options.patches:
        figures = evaluate_patches(bundle, Path(options.patches), classes, progress)
    else:
        named = paths(options.mission), paths(options.labels)
        missions = labelled_missions(*named, workspace, classes, bundle.grid, notice)
        stated = options.at_sea(missions, notice)
        figures = evaluate_missions(bundle, missions, classes, progress, wanted, stated)
    for line in _learnt_from(figures, "patches" if options.patches else "frames"):
        notice(line)
    return Evaluation(bundle, figures)


def _learnt_from(figures: dict[str, Any], what: str) -> list[str]:
    """A line where the model learnt from what it was scored on."""
    dives = figures.get("missions", [])
    if figures["seen_in_training"]:
        names = ", ".join(one["mission"] for one in dives if one["seen_in_training"])
        return [
            f"WARNING: the model learnt from {figures['seen_in_training']} of these {what}"
            f"{f' ({names})' if names else ''}: these are training figures, not a test"
        ]
    if figures.get("mission_in_training"):
        names = ", ".join(one["mission"] for one in dives if one["mission_in_training"])
        return [
            f"note: the model learnt from other frames of {names or 'this mission'}; another dive "
            "can go much worse than these figures"
        ]
    return []
