"""DatasetOptions, and the dataset version that they describe."""

import warnings
from dataclasses import dataclass
from pathlib import Path

from tokt.features.common.errors import ToktError, counted
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.mission import parse_frames
from tokt.labels.formats.options import Progress, no_progress
from tokt.labels.taxonomy import load_taxonomy
from tokt.training.options import Notice, OneOrMore, PathOrText, at_least, paths, takes

from .dataset import DatasetVersion, write_dataset
from .mission_source import (
    labelled_missions,
    passed_over,
    plan_from_missions,
    plan_from_patch_folder,
)
from .split import too_few_frames

_SHOWN = 10  # frames that were left out


@dataclass(frozen=True)
class DatasetOptions:
    """The options of ``tokt dataset build``, by its names: its help explains each.

    A path may be text; `mission` and `labels` take one or several.
    """

    name: str
    mission: OneOrMore = None
    labels: OneOrMore = None
    patches: PathOrText | None = None
    task: str = "binary"
    frames: str | None = None
    grid: Grid | str | None = None
    block: int | None = None
    taxonomy: PathOrText | None = None
    workspace: PathOrText = Path(".tokt")


@takes(DatasetOptions)
def build_dataset(
    options: DatasetOptions, *, progress: Progress = no_progress, notice: Notice = warnings.warn
) -> DatasetVersion:
    """Build a dataset version from labelled missions, or from a folder of patches.

    Parameters
    ----------
    options : DatasetOptions
        Or its fields, as in the example.
    progress : callable, optional
        ``progress(items, total, what)`` passes the items through, showing how far it is. Callables
        go with a `DatasetOptions`, not with fields.
    notice : callable, optional
        Is told, a line each, what a user should know.

    Returns
    -------
    DatasetVersion
        The same content gives the same version.

    Raises
    ------
    ToktError
        If a mission, its labels or an option cannot be used. It names options as the command line
        does: ``--max-samples`` is the field `max_samples`.

    Examples
    --------
    >>> tokt.build_dataset("tower", mission="dive", labels="dive/labels.csv")  # doctest: +SKIP
    DatasetVersion('tower@1f0c5d3b8a7e9d24': 9120 patches in 100 frames)
    """
    if bool(options.mission) == bool(options.patches):
        raise ToktError("give either --mission DIR or --patches DIR")
    at_least(options, block=1)
    workspace = Path(options.workspace)
    classes = load_taxonomy(workspace, *paths(options.taxonomy))
    remarks: list[str] = []
    if options.patches:
        if options.labels or options.frames or options.grid or options.block:
            raise ToktError(
                "--patches has its labels in its folder names; --labels, --frames, --grid and "
                "--block go with --mission"
            )
        folder = Path(options.patches)
        plan = plan_from_patch_folder(options.name, options.task, folder, classes)
        remarks += passed_over(folder)
    else:
        cells = Grid.parse(str(options.grid)) if options.grid else DEFAULT_GRID
        wanted = parse_frames(options.frames) if options.frames else None
        named = paths(options.mission), paths(options.labels)
        missions = labelled_missions(*named, workspace, classes, cells, notice)
        asked = options.name, options.task, missions, classes, cells, wanted, options.block
        plan, remarks = plan_from_missions(*asked, find_single_pictures=options.block is None)
    for remark in remarks:
        notice(f"note: {remark}")
    dataset = write_dataset(plan, workspace / "datasets", progress)
    tell_left_out(dataset, notice)
    if dataset.info["frames_that_are_copies"]:
        notice(
            f"note: {dataset.info['frames_that_are_copies']} frames are copies of others; blocks "
            "that share a picture stay on one side of every split"
        )
    if unseen := dataset.info.get("unseen_clear"):
        causes = ", ".join(f"{count} {cause}" for cause, count in unseen.items())
        notice(
            f"WARNING: {counted(sum(unseen.values()), 'patch')} labelled clear show nothing "
            f"({causes}). A model learns from them that such patches are water: mask them, or "
            "label them unsure"
        )
    lacking = dataset.block_frames and too_few_frames(
        dataset.patches, dataset.targets(), dataset.block_frames
    )
    if lacking:
        notice(f"WARNING: {lacking}")
    return dataset


def tell_left_out(dataset: DatasetVersion, notice: Notice) -> None:
    """Tell of frames and patches that a dataset was built without."""
    if left_out := dataset.info.get("left_out"):
        more = f"; and {len(left_out) - _SHOWN} more" if len(left_out) > _SHOWN else ""
        notice(
            f"WARNING: {counted(len(left_out), 'frame')} left out, damaged or unreadable: "
            f"{'; '.join(left_out[:_SHOWN])}{more}"
        )
    if contradictions := dataset.info.get("contradictions_left_out"):
        notice(
            f"WARNING: {counted(contradictions, 'patch')} left out: the very same picture is "
            "labelled as two classes"
        )
