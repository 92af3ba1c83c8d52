"""Help as plain text: commands and options under headings, a name in capitals for each value."""

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption
from typer.models import CommandFunctionType

from .completion import complete

_Row = tuple[str, tuple[str, str]]  # a heading, and what stands under it
_OTHERS = "Options"
_HEADINGS = {
    "label": {
        "Page": "port host token no_token no_browser",
        "Labels": "model annotator calibration taxonomy grid",
    },
    "import": {
        "File": "file_format mission_dir classes",
        "Labels": "annotator grid mission camera taxonomy",
    },
    "export": {"File": "file_format mission_dir full", "Labels": "mission annotator camera grid"},
    "build": {"Labels": "mission labels patches frames", "Version": "task grid block taxonomy"},
    "train": {
        "Model": "extractor preset name fixed_boundary ocean other",
        "Learning": "weight max_samples class_weight changes",
        "Cross-validation": "folds embargo split site stress",
        "Operating point": "false_status_rate confidence least_patches frame_rule",
        "Computing": "jobs dask",
    },
    "adapt": {"New dive": "mission labels", "Cross-validation": "split site draws"},
    "search": {
        "Search": "space budget nested fresh",
        "Cross-validation": "folds embargo split site weight",
        "Computing": "jobs dask",
    },
    "compare": {
        "Missions": "mission labels frames taxonomy",
        "Approaches": "rate stopping_distance calibration log",
        "Report": "output learning_curve ceilings",
    },
    "evaluate": {
        "Missions": "mission labels patches frames taxonomy",
        "Approaches": "rate stopping_distance calibration log",
    },
    "replay": {"Log": "run source export", "Judged by": "bundle store calibration"},
    "calibrate": {
        "Two cameras": "baseline focal start free frames fit",
        "Checkerboard": "board square",
        "Check": "check calibration",
    },
    "depth": {
        "Stereo": "calibration stereo scale rate",
        "Point cloud": "ply ply_frame ply_farthest",
        "Pictures": "out frames pictures",
    },
    "simulate": {"Closed loop": "closed_loop scenes methods runs model"},
    "reproduce": {
        "Pictures of the thesis": "ocean other dark dark_mask",
        "Mission": "calibration labels model sample",
    },
}
"""Which options of the long commands stand together; the others are `_OTHERS`, at the end."""
_VALUES = {
    "DIR": "out patches",
    "IMAGE": "ocean other dark dark_mask",
    "SECONDS": "seconds timeout",
    "MM": "baseline square",
    "PX": "focal width",
    "MS": "max_ms",
    "METRES": "ply_farthest",
    "PARTS": "free",
    "FRAMES": "pictures",
    "COLSxROWS": "board",
    "RATE": "false_status_rate",
    "WHY": "reason",
}
"""What stands for the values of some options; `_value_name` knows the others."""
_NAMED = {name: value for value, names in _VALUES.items() for name in names.split()}
_OWN_NAMES = ("log", "mission", "name", "source", "store", "port")
"""Paths and numbers that are called what they are."""


class Commands(typer.Typer):
    """Commands of one program or group, whose help is plain text under headings."""

    def __init__(self, name: str, help: str, **more: Any) -> None:
        super().__init__(name=name, cls=HelpGroup, help=help, rich_markup_mode=None, **more)

    def command(
        self, name: str | None = None, **more: Any
    ) -> Callable[[CommandFunctionType], CommandFunctionType]:
        """Make a function a command."""
        return super().command(name, cls=HelpCommand, **more)


class HelpGroup(TyperGroup):
    """Commands by their headings."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a line for each command."""
        width = formatter.width - 6 - max(map(len, self.commands))
        rows = [
            (_heading(each) or "Commands", (name, each.get_short_help_str(width)))
            for name, each in self.commands.items()
        ]
        _write(rows, formatter)


class HelpCommand(TyperCommand):
    """A command that names its values, completes them, and has its options by their headings."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        headings = {
            name: heading
            for heading, names in _HEADINGS.get(self.name or "", {}).items()
            for name in names.split()
        }
        for param in self.params:
            if isinstance(param, TyperArgument | TyperOption):
                param.rich_help_panel = headings.get(param.name or "", param.rich_help_panel)
                if not getattr(param, "is_flag", False):
                    param.metavar = param.metavar or _value_name(param)
                    param._custom_shell_complete = complete

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The pieces of the usage line; an argument that is required is its name alone."""
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write a line for each argument and option."""
        rows: list[_Row] = []
        for param in self.get_params(ctx):
            argument = param.param_type_name == "argument"
            heading = "Arguments" if argument else _heading(param) or _OTHERS
            if record := param.get_help_record(ctx):
                rows.append((heading, record))
        _write(sorted(rows, key=lambda row: row[0] == _OTHERS), formatter)


def _heading(of: object) -> str | None:
    """The heading that a command or an option has."""
    return getattr(of, "rich_help_panel", None)


def _value_name(param: TyperArgument | TyperOption) -> str:
    """What stands for a value that its declaration does not name."""
    name, kind = param.name or "", param.type.name
    if name not in _OWN_NAMES:
        name = "FILE" if kind == "path" else "N" if kind.startswith("int") else name
    return _NAMED.get(param.name or "", name.upper().replace("_", "-"))


def _write(rows: list[_Row], formatter: Any) -> None:
    """Write lines under their headings, in the order of the first of each."""
    sections: dict[str, list[tuple[str, str]]] = {}
    for heading, row in rows:
        sections.setdefault(heading, []).append(row)
    for heading, section in sections.items():
        with formatter.section(heading):
            formatter.write_dl(section)
