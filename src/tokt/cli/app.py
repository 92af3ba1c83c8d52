"""The `tokt` program: its commands, and how it ends when something is wrong."""

import os
import re
import sys
import time
import traceback
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from tokt.features.common.errors import ToktError, os_words
from tokt.features.common.extras import missing_extra
from tokt.features.common.terminal import live_without_terminal, open_standard_files, say

from . import InterruptEnds, run
from .completion import join_bash_words
from .help import Commands

_TRACEBACKS = 20  # files with tracebacks that are kept
_ENTRY_POINTS = "tokt.commands"
"""Group of the entry points by which other distributions add commands; each is a Typer app."""
_OF_STUDIES = ("demo", "simulate", "reproduce", "bench")
"""Commands of the distribution tokt-studies."""


def _new_app(**more: bool) -> Commands:
    made = Commands(
        "tokt",
        "Label, train, compare and deploy small texture models that keep an ROV off obstacles.",
        epilog="Exit codes: 0 done; 1 the answer is no, a check failed; 2 a user's mistake; "
        "70 a fault in tokt; 130 Ctrl-C. A fault's traceback is in a file.",
        pretty_exceptions_enable=False,
        **more,
    )
    made.callback(invoke_without_command=True)(_root)
    return made


def _print_version(wanted: bool) -> None:
    if wanted:
        from tokt import __version__

        typer.echo(f"tokt {__version__}")
        raise typer.Exit


def _root(
    context: typer.Context,
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _commands() -> dict[str, tuple[Any, ...]]:
    """The commands by their headings; each is its function's name."""
    # Imported where they are asked for: `run` is started sooner without.
    from . import cameras, compare, dataset, doctor, labels, models, replay, rig, train

    return {
        "Label": (labels.label, labels.labels_app),
        "Train and compare": (
            *(dataset.dataset_app, train.train, train.adapt, train.search),
            *(compare.compare, compare.evaluate, models.models_app),
        ),
        "Deploy": (models.export, models.keygen, models.deploy, models.rollback, models.store),
        "Run at sea": (
            *(run.run, run.listen, replay.replay),
            *(replay.findings, replay.shadow, doctor.doctor),
        ),
        "Cameras and stereo": (cameras.cameras, rig.calibrate, rig.depth),
    }


def core_app() -> Commands:
    """Return tokt's own commands, as a new app."""
    made = _new_app()
    for heading, commands in _commands().items():
        for command in commands:
            if isinstance(command, Commands):
                made.add_typer(command, rich_help_panel=heading)
            else:
                made.command(rich_help_panel=heading)(command)
    return made


def _is_own(name: str) -> bool:
    return name in {
        str(command.info.name) if isinstance(command, Commands) else command.__name__
        for commands in _commands().values()
        for command in commands
    }


@cache
def whole_app() -> Commands:
    """Return the commands of tokt and of other installed distributions."""
    from importlib.metadata import entry_points  # takes 10 ms, which `run` has no use for

    made = core_app()
    # Of two commands of one name typer has the later one: these give way to those of the studies.
    anything = {"allow_extra_args": True, "ignore_unknown_options": True}
    for name in _OF_STUDIES:
        settings = {"hidden": True, "add_help_option": False, "context_settings": anything}
        made.command(name, **settings)(_refuse_missing_studies)
    for entry in entry_points(group=_ENTRY_POINTS):
        try:
            others = entry.load()
        except (ImportError, AttributeError) as error:
            say(f"tokt: warning: the commands of {entry.value} cannot be loaded: {error}")
        else:
            made.registered_commands += others.registered_commands
            made.registered_groups += others.registered_groups
    return made


def _refuse_missing_studies(context: typer.Context) -> None:
    from tokt import __version__

    raise ToktError(
        f"tokt {context.info_name} comes with the distribution tokt-studies, which is not "
        f"installed: pip install tokt-studies=={__version__}"
    )


def _app_for(arguments: list[str]) -> typer.Typer:
    """Return the app that holds the command: `run` alone, tokt's own commands, or all commands.

    After a crash there is no time for the others, which take a sixth of the start of `run` to put
    together; and only what tokt itself does not have is looked for in other distributions.
    """
    if arguments[:1] == ["run"]:
        alone = _new_app(add_completion=False)
        alone.command()(run.run)
        return alone
    return core_app() if arguments and _is_own(arguments[0]) else whole_app()


def main() -> None:
    """Run the command line."""
    with InterruptEnds():
        open_standard_files()
        if os.environ.get("_TOKT_COMPLETE") == "complete_bash":
            join_bash_words(os.environ)
        if sys.argv[1:2] == ["run"]:
            live_without_terminal()
        commands = _app_for(sys.argv[1:])
    run_app(commands)


def run_app(commands: typer.Typer) -> None:
    """Run commands; an error is one line on stderr: exit code 2 for a user's mistake, else 70."""
    try:
        result = commands(standalone_mode=False)
        code = result() if callable(result) else result  # what a command leaves to be done
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(130)
    except Exception as error:  # noqa: BLE001 - nobody is left to catch it
        from . import interrupts

        if interrupts:
            sys.exit(130)
        message, code = _mistake(error), 2
        if message is None:
            message, code = _unexpected(error), 70
        say(f"tokt: error: {' '.join(message.split())}")
        sys.exit(code)
    else:
        sys.exit(code if isinstance(code, int) else 0)


def _mistake(error: Exception) -> str | None:
    """What a user can mend, or None."""
    if isinstance(error, ToktError):
        return str(error)
    if isinstance(error, typer.TyperException):
        words = re.sub("a valid int.*", "a whole number.", error.format_message())
        return re.sub("a valid float.*", "a number.", words)
    if isinstance(error, ModuleNotFoundError):
        missing = missing_extra(error, "this command")
        return None if missing is None else str(missing)
    if isinstance(error, OSError) and error.strerror is not None:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return None


def _unexpected(error: Exception) -> str:
    """Put an error's traceback into a file; what it is and where.

    The newest files only are kept: what is started again may die of the same error each time.
    """
    import tempfile

    name = "tokt-traceback-"
    prefix = f"{name}{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}-"
    try:
        # First, and not after it: a disk may be full, or a clock set back.
        for old in sorted(Path(tempfile.gettempdir()).glob(f"{name}*.txt"))[: 1 - _TRACEBACKS]:
            with suppress(OSError):  # another user's
                old.unlink()
        with tempfile.NamedTemporaryFile(suffix=".txt", prefix=prefix, delete=False) as file:
            file.write("".join(traceback.format_exception(error)).encode(errors="replace"))
        where = f"the traceback is in {file.name}"
    except OSError as failure:
        where = f"the traceback cannot be written: {os_words(failure)}"
    what = ToktError(f"{type(error).__name__}: {error}")  # printable, and not too long
    return f"a fault in tokt, please report it: {what}; {where}"
