"""``tokt models``, ``export``, ``deploy``, ``rollback`` and ``store``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ..features.errors import ToktError
from .options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption
from .output import print_json

models_app = typer.Typer(help="Registered model versions.", no_args_is_help=False)

ModelArgument = Annotated[
    str, typer.Argument(help="NAME, NAME@ALIAS, NAME/VERSION or a .tokt file.")
]
StoreArgument = Annotated[Path, typer.Argument(help="The store's folder.")]
ReasonOption = Annotated[str, typer.Option(help="Why; kept in the store's history.")]


@models_app.command("list")
def list_(workspace: WorkspaceOption = DEFAULT_WORKSPACE, json: JsonOption = False) -> None:
    """List every registered version."""
    from ..models.registry import Registry

    found = Registry(workspace).versions()
    if json:
        print_json({"models": [asdict(item) for item in found]})
        return
    for item in found:
        aliases = "".join(f" @{alias}" for alias in item.aliases)
        print(
            f"{item.label}{aliases}  {item.tags.get('extractor', '')} on "
            f"{item.tags.get('dataset', '')}"
        )


@models_app.command("show")
def show(
    model: ModelArgument,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Show a model's card: what it is, what was measured, where it comes from."""
    from ..models.registry import load_model

    bundle = load_model(model, workspace)
    content = bundle.content
    if json:
        print_json(
            {
                "name": bundle.name,
                "version": bundle.version,
                "sha256": bundle.sha256,
                "extractor": dict(content.extractor_spec),
                "grid": content.grid.to_json(),
                "classes": list(content.model.classes),
                "obstacle": list(content.model.obstacle),
                "thresholds": content.model.thresholds.tolist(),
                "provenance": dict(content.provenance),
                "metrics": dict(content.metrics),
            }
        )
        return
    print(content.card, end="")


@models_app.command("alias")
def alias(
    model: Annotated[str, typer.Argument(help="NAME, NAME@ALIAS or NAME/VERSION.")],
    alias: Annotated[str, typer.Argument(help="For example champion.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
) -> None:
    """Point an alias at a version."""
    from ..models.registry import Registry

    version = Registry(workspace).set_alias(model, alias)
    print(f"{version.label} is now {version.name}@{alias}")


def export(
    model: ModelArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file, ending in .tokt.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Write a model version as a bundle, the one file that is shipped."""
    from ..features.atomic import write_bytes
    from ..models.bundle import SUFFIX
    from ..models.registry import load_model

    if output.suffix != SUFFIX:
        raise ToktError(f"a bundle's name ends in {SUFFIX}, unlike {output}")
    bundle = load_model(model, workspace)
    try:
        write_bytes(output, bundle.data)
    except OSError as error:
        raise ToktError(f"{output}: {error.strerror or error}") from None
    if json:
        print_json({"file": str(output), "model": bundle.label, "sha256": bundle.sha256})
        return
    print(f"{output}: {bundle.label}, {len(bundle.data) / 1e6:.1f} MB, sha256 {bundle.sha256}")


def deploy(
    model: ModelArgument,
    store: StoreArgument,
    reason: ReasonOption = "",
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Check a model and make it the active one of a store."""
    from ..models.bundle import SUFFIX, read_bundle
    from ..models.store import Store

    if model.endswith(SUFFIX):
        bundle = read_bundle(model)
    else:
        from ..models.registry import load_model

        bundle = load_model(model, workspace)
    entry = Store(store).deploy(bundle, reason)
    _print_activation(store, asdict(entry), json)


def rollback(store: StoreArgument, reason: ReasonOption = "", json: JsonOption = False) -> None:
    """Go back to the model that was active before."""
    from ..models.store import Store

    entry = Store(store).rollback(reason)
    _print_activation(store, asdict(entry), json)


def store(store: StoreArgument, json: JsonOption = False) -> None:
    """Show what is active in a store, and what has been."""
    from ..models.store import Store

    if not store.is_dir():
        raise ToktError(f"store {store} does not exist")
    value = Store(store).to_json()
    if json:
        print_json(value)
        return
    active = value["active"]
    print(f"active: {active['name']}/{active['version']}" if active else "active: none")
    for entry in value["history"]:
        print(
            f"  {entry['number']}  {entry['time']}  {entry['action']:8}  "
            f"{entry['name']}/{entry['version']}  {entry['sha256'][:12]}  by {entry['who']}"
            f"{'  ' + entry['reason'] if entry['reason'] else ''}"
        )


def _print_activation(store: Path, entry: dict[str, object], json: bool) -> None:
    if json:
        print_json(entry)
        return
    print(f"{store}: {entry['name']}/{entry['version']} is active ({entry['action']})")
