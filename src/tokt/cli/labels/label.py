"""`tokt label`: the labelling page, in the browser, from a server on this computer."""

from __future__ import annotations

import getpass
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tokt.cli.options import DEFAULT_WORKSPACE, TaxonomyOption, WorkspaceOption
from tokt.features.common.errors import ToktError

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle


def label(
    mission: Annotated[
        Path, typer.Argument(metavar="MISSION", help="A folder of frames or a video file.")
    ],
    port: Annotated[
        int, typer.Option(help="Port of the page; 0 takes any free port.", min=0, max=65535)
    ] = 8118,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDR", help="Address to serve on; all but loopback require the token."
        ),
    ] = "127.0.0.1",
    token: Annotated[
        str | None,
        typer.Option(metavar="T", help="Token to require. Default with --host: a new one."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="BUNDLE", help="Show this model's suggestions: a .tokt file or a model's name."
        ),
    ] = None,
    annotator: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Name of the annotator. Default: the user's name."),
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address and open no browser.")
    ] = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    taxonomy: TaxonomyOption = None,
    grid: Annotated[
        str, typer.Option(metavar="ROWSxCOLS@WIDTH", help="Grid of patches to label.")
    ] = "10x10@360",
) -> None:
    """Label a mission's patches in the browser, until Ctrl-C."""
    from tokt import __version__
    from tokt.cli.interrupt import stop_on_signal
    from tokt.features.frames.grid import Grid
    from tokt.features.frames.mission import open_mission
    from tokt.labels.page.api.serve import listen, serve
    from tokt.labels.page.state.session import open_session

    if token is not None and not token.strip():
        raise ToktError("--token is empty")
    patches = Grid.parse(grid)
    frames = open_mission(mission)
    bundle = None if model is None else _load(model, workspace)
    address = listen(host, port, token)
    session = open_session(
        frames, workspace, patches, annotator or _user(), __version__, taxonomy, bundle
    )

    def ready() -> None:
        typer.echo(f"labelling {frames.name} at {address.url} (Ctrl-C ends)")
        if not no_browser:
            _open_browser(address.url)

    with stop_on_signal(lambda: None):
        serve(session, address.socket, address.rules, ready)
    session.close()


def _load(model: str, workspace: Path) -> Bundle:
    from tokt.models.registry.load import load_model

    return load_model(model, workspace)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        raise ToktError("this user has no name; say who labels with --annotator") from None


def _open_browser(url: str) -> None:
    import webbrowser

    # Some browsers return only when they are closed.
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
