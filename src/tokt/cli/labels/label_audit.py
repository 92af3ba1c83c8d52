"""`tokt labels audit`: labels that held-out decisions contradict, for a person to look at."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tokt.cli.options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption
from tokt.cli.output import print_json, progress

if TYPE_CHECKING:
    from tokt.labels.formats.audit_csv import Audit

_SHOWN = 10


def audit_labels(
    reference: Annotated[
        str,
        typer.Argument(metavar="DATASET|MODEL", help="NAME, NAME@HASH, NAME@ALIAS, NAME/VERSION."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE.csv", help="Label file to write, with reasons."
        ),
    ] = None,
    top: Annotated[int | None, typer.Option(help="Show the worst N only.", min=1)] = None,
    folds: Annotated[
        int | None, typer.Option(help="Folds of a dataset's cross-validation. Default: 5.", min=2)
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes for features; -1 for one per core.")] = -1,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Rank labels that held-out models contradict; no label is changed.

    They are kept in the workspace for the labelling page: its review sheet shows them under Audit.
    """
    from tokt.labels.formats.audit_csv import write_audit, write_audit_csv
    from tokt.training.fitting.label_audit import audit, audit_input_named

    found = audit(
        audit_input_named(reference, workspace, folds), workspace / "cache", progress, top, jobs
    )
    kept = write_audit(workspace, found)
    if output is not None:
        write_audit_csv(output, found)
    if json:
        print_json(
            {
                "name": found.name,
                "of": found.of,
                "rule": found.rule,
                "file": str(kept),
                "csv": str(output) if output else None,
                "doubted": len(found.patches),
                "patches": [asdict(patch) for patch in found.patches],
            }
        )
        return
    _print_audit(found)
    for file in (kept, output):
        if file is not None:
            typer.echo(f"  in {file}")


def _print_audit(found: Audit) -> None:
    typer.echo(f"{found.of}: {len(found.patches)} labels are contradicted")
    typer.echo(f"  {found.rule}")
    for patch in found.patches[:_SHOWN]:
        where = f"{patch.mission} {patch.camera} {patch.frame} row {patch.row} col {patch.col}"
        typer.echo(f"  {patch.margin:8.2f}  {where}: labelled {patch.label}, {patch.reason}")
    if len(found.patches) > _SHOWN:
        typer.echo(f"  ... and {len(found.patches) - _SHOWN} more")
