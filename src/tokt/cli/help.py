"""Help as plain text: commands and options under headings, a name in capitals for each value."""

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption
from typer.models import CommandFunctionType

from .completion import complete

_OTHERS = "Options"
_FEW = 6  # options that need no headings
_HEADINGS = {
    "Page": "port host token no_token no_browser",
    "Missions and labels": "mission labels patches frames grid taxonomy annotator camera "
    "label.model label.calibration",
    "File": "file_format mission_dir classes full",
    "Dataset": "task block",
    "Model": "extractor preset name fixed_boundary sharp_frames",
    "Images": "ocean other",
    "Learning": "weight max_samples class_weight changes",
    "Cross-validation": "folds embargo split site stress draws",
    "Operating point": "false_status_rate confidence least_patches frame_rule",
    "Search": "space budget nested fresh",
    "Computing": "jobs dask",
    "Two cameras": "baseline focal start free fit",
    "Checkerboard": "board square",
    "Check": "check calibrate.calibration",
    "Distances": "calibration stereo scale rate stopping_distance log",
    "Point cloud": "ply ply_frame ply_farthest fused",
    "Several frames": "depth.odometry depth.log depth.export",
    "Log": "run source export",
    "Judged by": "bundle store replay.calibration",
}
"""Options that stand together where a command has many; the others are `_OTHERS`, at the end."""
_VALUES = """
    annotator=NAME baseline=MM board=COLSxROWS budget=TIME|N camera=left|right
    class_weight=none|balanced|auto classes=THEIRS=OURS confidence=SHARE
    dask=ADDRESS distrust=ID false_status_rate=RATE fit=alternate|even|odd|all focal=PX
    force=WHY frame_rule=K/N|auto free=PARTS grid=ROWSxCOLS@WIDTH learning_curve=MODEL
    least_patches=N|auto max_ms=MS mission=MISSION mission_dir=DIR models=MODEL... name=NAME
    ocean=IMAGE other=IMAGE out=DIR patches=DIR pictures=FRAMES
    ply_farthest=METRES port=PORT
    preset=thesis|plain|water|best|lite|lite_water rate=FPS reason=WHY registered_by=KEY.pub
    seconds=SECONDS
    sign=KEY site=NAME=A,B source=SOURCE space=FILE.toml split=dive|block square=MM stereo=bm|sgbm
    stereo_scale=SCALE stopping_distance=METRES store=STORE task=binary|classes timeout=SECONDS
    trust=KEY.pub udp=HOST:PORT weight=dive|patch workspace=DIR
"""
"""What stands for the value of an option or argument that its declaration gives no ``metavar``."""
_HEADING_OF = {name: of for of, names in _HEADINGS.items() for name in names.split()}
_NAMED = dict(pair.split("=", 1) for pair in _VALUES.split())


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
        shown = {name: each for name, each in self.commands.items() if not each.hidden}
        width = formatter.width - 6 - max(map(len, shown))
        rows = [
            (_heading(each, "Commands"), (name, each.get_short_help_str(width)))
            for name, each in shown.items()
        ]
        _write(rows, formatter)


class HelpCommand(TyperCommand):
    """A command that names its values, completes them, and has its options by their headings."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        options = []
        for param in self.params:
            if isinstance(param, TyperOption):
                options.append(param)
            if isinstance(param, TyperArgument):
                param.rich_help_panel = "Arguments"
            if isinstance(param, TyperArgument | TyperOption) and param.type.name != "boolean":
                param.metavar = param.metavar or _value_name(param.name or "", param.type.name)
                param._custom_shell_complete = complete
        if len(options) > _FEW:
            headings = [
                _HEADING_OF.get(f"{self.name}.{option.name}", _HEADING_OF.get(option.name or ""))
                for option in options
            ]
            for option, heading in zip(options, headings, strict=True):
                if headings.count(heading) > 1:
                    option.rich_help_panel = option.rich_help_panel or heading

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The pieces of the usage line; an argument that is required is its name alone."""
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write a line for each argument and option."""
        lines = [(param, param.get_help_record(ctx)) for param in self.get_params(ctx)]
        rows = [(_heading(param, _OTHERS), line) for param, line in lines if line]
        _write(sorted(rows, key=lambda row: row[0] == _OTHERS), formatter)


def _heading(of: object, otherwise: str) -> str:
    """The heading of a command, an option or an argument."""
    return getattr(of, "rich_help_panel", None) or otherwise


def _value_name(name: str, kind: str) -> str:
    """What stands for a value: as `_VALUES` has it, else FILE, N or the name of the option."""
    by_kind = "FILE" if kind == "path" else "N" if kind.startswith("int") else name
    return _NAMED.get(name, by_kind.upper().replace("_", "-"))


def _write(rows: list[tuple[str, tuple[str, str]]], formatter: Any) -> None:
    """Write lines under their headings, in the order of the first of each."""
    sections: dict[str, list[tuple[str, str]]] = {}
    for heading, row in rows:
        sections.setdefault(heading, []).append(row)
    for heading, section in sections.items():
        with formatter.section(heading):
            formatter.write_dl(section)
