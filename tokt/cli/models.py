"""``tokt models``, ``export``, ``deploy``, ``rollback`` and ``store``."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..features.errors import ToktError
from .options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption
from .output import print_json, say

if TYPE_CHECKING:
    from ..models.bundle import Bundle

models_app = typer.Typer(help="Registered model versions.", no_args_is_help=False)

ModelArgument = Annotated[
    str, typer.Argument(help="NAME, NAME@ALIAS, NAME/VERSION or a .tokt file.")
]
StoreArgument = Annotated[Path, typer.Argument(help="The store's folder.")]
FlagsOption = Annotated[
    Path | None,
    typer.Option(
        "--taxonomy",
        metavar="FILE",
        help="Taxonomy file that says which classes are obstacles. Default: as trained.",
    ),
]
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
    from ..models.load import load_model

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
                "operating_point": content.operating_point.to_json(),
                "latency_frames": content.operating_point.rule.latency_frames,
                "provenance": dict(content.provenance),
                "metrics": dict(content.metrics),
                "card": content.card,
            }
        )
        return
    print(content.card, end="")


@models_app.command("alias")
def alias(
    model: Annotated[str, typer.Argument(help="NAME, NAME@ALIAS or NAME/VERSION.")],
    alias: Annotated[str, typer.Argument(help="For example champion.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Point an alias at a version."""
    from ..models.registry import Registry

    version = Registry(workspace).set_alias(model, alias)
    if json:
        print_json(asdict(version))
        return
    print(f"{version.label} is now {version.name}@{alias}")


def _shipped(model: str, workspace: Path, taxonomy: Path | None) -> Bundle:
    """The bundle to ship, with the obstacle flags of a taxonomy file if one is given."""
    from ..models.load import load_model

    bundle = load_model(model, workspace)
    if taxonomy is None:
        return bundle
    from ..labels.taxonomy import Taxonomy
    from ..models.reflag import PROVENANCE_KEY, reflagged

    known = {item.name: item.obstacle for item in Taxonomy.load(taxonomy).classes}
    sha256 = hashlib.sha256(taxonomy.read_bytes()).hexdigest()
    found = reflagged(bundle, known, taxonomy.name, sha256)
    if found is bundle:
        say(f"note: {taxonomy} changes nothing: {bundle.label} has these obstacles already")
        return bundle
    changed = found.content.provenance[PROVENANCE_KEY]["changed"].items()
    words = ", ".join(f"{name} is {'an obstacle' if flag else 'clear'}" for name, flag in changed)
    say(
        f"WARNING: {found.label} by {taxonomy}: {words}. The operating point was chosen for other "
        "flags and is void: status 1 with 1 patch over the threshold, in one frame"
    )
    return found


def export(
    model: ModelArgument,
    output: Annotated[Path, typer.Option("--output", "-o", help="The file, ending in .tokt.")],
    taxonomy: FlagsOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Write a model version as a bundle, the one file that is shipped."""
    from ..features.atomic import write_bytes
    from ..models.bundle import SUFFIX

    if output.suffix != SUFFIX:
        raise ToktError(f"a bundle's name ends in {SUFFIX}, unlike {output}")
    bundle = _shipped(model, workspace, taxonomy)
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
    taxonomy: FlagsOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Check a model and make it the active one of a store."""
    from ..models.store import Store

    entry = Store(store).deploy(_shipped(model, workspace, taxonomy), reason, notice=say)
    _print_activation(store, asdict(entry), json)


def rollback(store: StoreArgument, reason: ReasonOption = "", json: JsonOption = False) -> None:
    """Go back to the model that was active before."""
    from ..models.store import Store

    entry = Store(store).rollback(reason)
    _print_activation(store, asdict(entry), json)


def store(store: StoreArgument, json: JsonOption = False) -> None:
    """Show what is active in a store, where it comes from, and what has been active."""
    from ..models.store import Store

    value = Store(store).to_json()
    if json:
        print_json(value)
        return
    for warning in value["warnings"]:
        say(f"WARNING: {warning}")
    if value["active"] is None:
        print("active: not known" if value["warnings"] else "active: none")
    else:
        _print_active(value["active"], value["provenance"])
    for entry in value["history"]:
        print(
            f"  {entry['number']}  {entry['time']}  {entry['action']:8}  "
            f"{entry['name']}/{entry['version']}  {entry['sha256'][:12]}  by {entry['who']}"
            f"{'  ' + entry['reason'] if entry['reason'] else ''}"
        )


_ORIGIN = {
    "dataset": "dataset",
    "dataset_hash": "dataset hash",
    "dataset_sources": "missions and labels",
    "mlflow_run_id": "MLflow run",
    "code_version": "code version",
}


def _print_active(active: dict[str, Any], provenance: dict[str, Any] | None) -> None:
    print(f"active: {active['name']}/{active['version']}")
    if provenance is None:
        return
    for key, what in _ORIGIN.items():
        text = str(provenance.get(key, "not recorded in the bundle"))
        print(f"  {what}: {' '.join(text.split())}")
    if "obstacle_flags" in provenance:
        print(f"  obstacles set when it was shipped: {provenance['obstacle_flags']}")


def _print_activation(store: Path, entry: dict[str, object], json: bool) -> None:
    if json:
        print_json(entry)
        return
    print(f"{store}: {entry['name']}/{entry['version']} is active ({entry['action']})")
