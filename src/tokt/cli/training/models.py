"""``tokt models`` and ``export``."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tokt.cli.deploy.keygen import SignOption, signing_key
from tokt.cli.options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption
from tokt.cli.output import print_json, say
from tokt.features.common.errors import ToktError

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle

models_app = typer.Typer(
    help="List, show and alias registered model versions.", no_args_is_help=False
)

ModelArgument = Annotated[
    str, typer.Argument(help="NAME, NAME@ALIAS, NAME/VERSION or a .tokt file.")
]
FlagsOption = Annotated[
    Path | None,
    typer.Option(
        "--taxonomy",
        metavar="FILE",
        help="Taxonomy file that sets which classes are obstacles. Default: as trained.",
    ),
]


@models_app.command("list")
def list_(workspace: WorkspaceOption = DEFAULT_WORKSPACE, json: JsonOption = False) -> None:
    """List every registered version."""
    from tokt.models.registry.registry import Registry

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
    """Show a model's card: description, figures, origin."""
    from tokt.models.registry.load import load_model

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
    alias: Annotated[str, typer.Argument(help="Alias, such as champion.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Point an alias at a version."""
    from tokt.models.registry.registry import Registry

    version = Registry(workspace).set_alias(model, alias)
    if json:
        print_json(asdict(version))
        return
    print(f"{version.label} is now {version.name}@{alias}")


def shipped(model: str, workspace: Path, taxonomy: Path | None, sign: Path | None) -> Bundle:
    """The bundle to ship: with the obstacle flags of a taxonomy file, and signed, where asked."""
    from tokt.models.registry.load import load_model

    key = None if sign is None else signing_key(sign)
    bundle = load_model(model, workspace)
    if taxonomy is not None:
        bundle = _flagged(bundle, taxonomy)
    return bundle if key is None else key.sign(bundle, f"model {bundle.label}")


def _flagged(bundle: Bundle, taxonomy: Path) -> Bundle:
    from tokt.labels.taxonomy import Taxonomy
    from tokt.models.bundle.override_obstacle_classes import (
        PROVENANCE_KEY,
        override_obstacle_classes,
    )

    known = {item.name: item.obstacle for item in Taxonomy.load(taxonomy).classes}
    sha256 = hashlib.sha256(taxonomy.read_bytes()).hexdigest()
    found = override_obstacle_classes(bundle, known, taxonomy.name, sha256)
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
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Bundle file to write, ending in .tokt.")
    ],
    taxonomy: FlagsOption = None,
    sign: SignOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Export a model version as a bundle, the one file that is shipped."""
    from tokt.features.common.atomic import write_bytes
    from tokt.models.bundle.bundle import SUFFIX

    if output.suffix != SUFFIX:
        raise ToktError(f"a bundle's name ends in {SUFFIX}, unlike {output}")
    bundle = shipped(model, workspace, taxonomy, sign)
    try:
        write_bytes(output, bundle.data)
    except OSError as error:
        raise ToktError(f"{output}: {error.strerror or error}") from None
    key_id = None if bundle.signature is None else bundle.signature.key_id
    if json:
        found = {"file": str(output), "model": bundle.label, "sha256": bundle.sha256}
        print_json({**found, "signed_by": key_id})
        return
    print(f"{output}: {bundle.label}, {len(bundle.data) / 1e6:.1f} MB, sha256 {bundle.sha256}")
    if key_id is not None:
        print(f"signed by key {key_id}")
