"""EvaluateOptions, the evaluation that they describe, and what options state of missions."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import open_mission, parse_frames
from tokt.features.frames.view_mask import mask_options
from tokt.inference.sharp_frames import measure_sharp_frames
from tokt.labels.formats.options import Progress, no_progress
from tokt.labels.taxonomy import load_taxonomy
from tokt.models.bundle.bundle import Bundle
from tokt.models.registry.load import load_model
from tokt.training.calibration.any_form import read_calibration_file
from tokt.training.datasets.mission_source import LabelledMission, labelled_missions
from tokt.training.options import Notice, OneOrMore, PathOrText, paths, takes

from .approaches import AtSea, logged_distances
from .evaluate import evaluate_missions, evaluate_patches


@dataclass(frozen=True, kw_only=True)
class MissionOptions:
    """The options of ``tokt evaluate`` and ``tokt compare`` that are of missions."""

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
    """The options of ``tokt evaluate``, by its names: its help explains each."""

    model: PathOrText
    patches: PathOrText | None = None
    fixed_boundary: bool = False
    sharp_frames: PathOrText | None = None


@takes(EvaluateOptions)
def evaluate(
    options: EvaluateOptions, *, progress: Progress = no_progress, notice: Notice = warnings.warn
) -> tuple[Bundle, dict[str, Any]]:
    """Score a model on labelled missions, or on ready-cut patches.

    Parameters
    ----------
    options : EvaluateOptions
        Or its fields, as in the example.
    progress, notice : callable, optional
        As for `build_dataset`. `notice` is told of a model that learnt from what it is scored on.

    Returns
    -------
    model : Bundle
        The model that was scored.
    figures : dict
        The JSON object of ``tokt evaluate --json``.

    Raises
    ------
    ToktError
        If the model, a mission, its labels or an option cannot be used.

    Examples
    --------
    >>> model, figures = tokt.evaluate("tower-lbp", mission="dive2")  # doctest: +SKIP
    >>> figures["frames"]["false_status"]  # doctest: +SKIP
    0
    """
    if bool(options.mission) == bool(options.patches):
        raise ToktError("give either --mission DIR or --patches DIR")
    if options.patches and (options.are_stated or options.sharp_frames):
        raise ToktError(
            "--patches has its labels in its folder names; --labels, --frames, --rate, "
            "--stopping-distance, --calibration, --log and --sharp-frames go with --mission"
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
        if options.sharp_frames:
            sharp = open_mission(Path(options.sharp_frames))
            if len(missions) > 1:
                raise ToktError("--sharp-frames goes with one mission")
            masks = missions[0].mission.masks
            bundle = bundle.with_sight(measure_sharp_frames(sharp, masks, accept_blind=True))
        figures = evaluate_missions(bundle, missions, classes, progress, wanted, stated)
    for name, boxes in figures.get("always_alarming", {}).items():
        if boxes:
            notice(
                f"WARNING: patches of mission {name!r} alarm in nearly all frames of open water. "
                "Mask them if they are a clock, a rim or a part of the vehicle, on the labelling "
                f"page or by {mask_options(boxes, 'left')}"
            )
    for line in _learnt_from(figures, "patches" if options.patches else "frames"):
        notice(line)
    return bundle, figures


def _learnt_from(figures: dict[str, Any], what: str) -> list[str]:
    """A line where the model learnt from what it was scored on."""
    dives = figures.get("missions", [])
    if figures["seen_in_training"]:
        names = ", ".join(one["mission"] for one in dives if one["seen_in_training"])
        line = (
            f"WARNING: the model learnt from {figures['seen_in_training']} of these {what}"
            f"{f' ({names})' if names else ''}: these are training figures, not a test"
        )
        choose = ". tokt models show says which; --frames chooses others"
        return [line + choose if what == "frames" else line]
    if figures.get("mission_in_training"):
        names = ", ".join(one["mission"] for one in dives if one["mission_in_training"])
        return [
            f"note: the model learnt from other frames of {names or 'this mission'}; another dive "
            "can go much worse than these figures"
        ]
    return []
