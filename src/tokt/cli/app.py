"""The `tokt` program: its commands, and how it ends when something is wrong."""

import sys
from typing import Annotated

import typer
from typer import Option

from tokt.features.common.errors import ToktError, printable

from . import compare, dataset, doctor, labels, models, replay, rig, run, studies, train
from .output import live_without_terminal, open_standard_files

_EXTRAS = {
    "scipy": "train",
    **dict.fromkeys(("mlflow", "sklearn", "skops", "pandas", "pyarrow", "joblib"), "train"),
    **dict.fromkeys(("matplotlib", "jinja2", "skimage", "mahotas"), "train"),
    **dict.fromkeys(("fastapi", "starlette", "pydantic", "uvicorn"), "label"),
    "pymba": "camera",
    "cryptography": "sign",
    **dict.fromkeys(("dask", "distributed", "psutil"), "cluster"),
    "threadpoolctl": "train",
}


def _new_app() -> typer.Typer:
    made = typer.Typer(
        name="tokt",
        help="Label, train, compare and deploy small texture models that keep an ROV off "
        "obstacles.",
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
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


app = _new_app()
app.command("demo")(studies.demo)
app.command("label")(labels.label)
app.add_typer(labels.labels_app, name="labels")
app.add_typer(dataset.dataset_app, name="dataset")
app.command("train")(train.train)
app.command("search")(train.search)
app.command("compare")(compare.compare)
app.command("evaluate")(compare.evaluate)
app.add_typer(models.models_app, name="models")
app.command("export")(models.export)
app.command("keygen")(models.keygen)
app.command("deploy")(models.deploy)
app.command("rollback")(models.rollback)
app.command("store")(models.store)
app.command("run", cls=run.RunCommand)(run.run)
app.command("replay")(replay.replay)
app.command("shadow")(replay.shadow)
app.command("calibrate")(rig.calibrate)
app.command("depth")(rig.depth)
app.command("listen")(run.listen)
app.command("simulate")(studies.simulate)
app.command("reproduce")(studies.reproduce)
app.command("bench")(studies.bench)
app.command("doctor")(doctor.doctor)


def _app_for(arguments: list[str]) -> typer.Typer:
    """The commands; of the runtime's that one only: after a crash there is no time for the others,
    which take a sixth of its start to put together.
    """
    if arguments[:1] != ["run"]:
        return app
    alone = _new_app()
    alone.command("run", cls=run.RunCommand)(run.run)
    return alone


def main() -> None:
    """Run the command line."""
    open_standard_files()
    if sys.argv[1:2] == ["run"]:
        live_without_terminal()
    run_app(_app_for(sys.argv[1:]))


def run_app(commands: typer.Typer) -> None:
    """Run commands; a user's mistake is one line on stderr and exit code 2."""
    try:
        code = commands(standalone_mode=False)
    except ToktError as error:
        _fail(str(error))
    except typer.TyperException as error:
        _fail(error.format_message())
    except ModuleNotFoundError as error:
        extra = _EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        _fail(f"this command needs {error.name}: install tokt[{extra}]")
    except OSError as error:
        if error.strerror is None:
            raise
        _fail(f"{error.filename}: {error.strerror}" if error.filename else error.strerror)
    except typer.Abort:
        sys.exit(130)
    else:
        sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> None:
    print(f"tokt: error: {printable(' '.join(message.split()))}", file=sys.stderr)
    sys.exit(2)
