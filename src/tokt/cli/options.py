"""Options and arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

WorkspaceOption = Annotated[Path, Option(help="Folder that holds tokt's state.")]
JsonOption = Annotated[bool, Option("--json", help="Print one JSON object.")]
TaxonomyOption = Annotated[
    Path | None, Option(help="Taxonomy file. Default: the workspace's, else the built-in one.")
]
DatasetArgument = Annotated[str, Argument(help="Dataset: NAME or NAME@HASH.")]
ModelArgument = Annotated[
    str,
    Argument(
        help="Model: NAME, NAME@ALIAS, NAME/VERSION, a .tokt file, a store's folder or waters, "
        "which comes with tokt."
    ),
]
RegisteredModelArgument = Annotated[
    str, Argument(help="Registered model: NAME, NAME@ALIAS or NAME/VERSION.")
]
FixedBoundaryOption = Annotated[
    bool,
    Option(
        "--fixed-boundary",
        help="Keep the boundary between water and obstacles fixed from frame to frame.",
    ),
]
SharpFramesOption = Annotated[
    Path | None,
    Option(
        metavar="FRAMES",
        help="Sharp frames of a camera that the model did not learn, as for tokt run.",
    ),
]
FramesOption = Annotated[str | None, Option(help="Use these frames only, such as 1-99,132-246.")]
MissionsOption = Annotated[
    list[Path] | None,
    Option(
        metavar="[NAME=]DIR",
        help="Mission folder or video, NAME as its labels call it; or a missions.toml that lists "
        "several. Repeatable.",
    ),
]
PatchesOption = Annotated[
    Path | None, Option(help="Folder with one sub-folder of patch images per class.")
]
LabelFilesOption = Annotated[
    list[Path] | None, Option(help="Label file; repeatable. Default: the label store.")
]
FoldsOption = Annotated[
    int | None,
    Option(
        help="Folds of the cross-validation. Default: as many as the labels can bear, mostly 5.",
        min=2,
    ),
]
EmbargoOption = Annotated[
    int | None,
    Option(
        help="Frames left out of training on each side of a test frame; none of single pictures. "
        "Default: a quarter of a block.",
        min=0,
    ),
]
ReportOption = Annotated[Path | None, Option("-o", "--output", help="HTML report to write.")]
LoggedRunOption = Annotated[
    str | None, Option(help="Run of the log, by its ID. Default: the last one.")
]


def fields_of(given: dict[str, Any]) -> dict[str, Any]:
    """A command's arguments as its options dataclass names them: all but `json`."""
    return {name: value for name, value in given.items() if name != "json"}


def is_written(context: typer.Context, name: str) -> bool:
    """Whether an option is on the command line, be it with its default value."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"
