"""``tokt search``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tokt.cli.options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption
from tokt.cli.output import print_json, progress

_RULE = (
    "the simplest within one standard error, and 0.01, of the best (result.json has the rule in "
    "full)"
)


def search(
    dataset: Annotated[str, typer.Argument(help="NAME or NAME@HASH.")],
    name: Annotated[
        str | None, typer.Option(help="Name of the winning model. Default: DATASET-search.")
    ] = None,
    space: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help="Space file: extractors, C and class weights to try. Default: the built-in one.",
        ),
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(
            help="Budget: begin no trial after this time (30m, 2h) or number of trials (12)."
        ),
    ] = None,
    nested: Annotated[
        bool,
        typer.Option(
            "--nested",
            help="Repeat the search inside each training part as well, for an honest score.",
        ),
    ] = False,
    fresh: Annotated[
        bool, typer.Option("--fresh/--resume", help="Discard finished trials, or resume from them.")
    ] = False,
    folds: Annotated[int, typer.Option(help="Folds of the cross-validation.", min=2)] = 5,
    embargo: Annotated[
        int, typer.Option(help="Frames left out of training on each side of a test frame.", min=1)
    ] = 5,
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.", min=-1)] = -1,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Dask cluster to work on that sees the same files (tcp://HOST:8786).",
        ),
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Search extractors; train and register the simplest of the best.

    Each is scored by blocked cross-validation. A search that was stopped goes on where it was.
    """
    from tokt.models.registry.registry import Registry, check_model_name
    from tokt.training.datasets.dataset import open_dataset
    from tokt.training.fitting.cross_validation import Split
    from tokt.training.search.search import SearchRequest, budget_from
    from tokt.training.search.search import search as search_task
    from tokt.training.search.space import BUILT_IN, read_space

    data = open_dataset(dataset, workspace / "datasets")
    model_name = name or f"{data.name}-search"
    check_model_name(model_name)
    request = SearchRequest(
        data,
        model_name,
        read_space(space or BUILT_IN),
        Split(folds, embargo),
        workspace,
        budget_from(budget),
        nested,
        fresh,
        jobs,
        dask,
    )
    result = search_task(request, Registry(workspace, create=True), progress)
    if json:
        print_json(result)
    else:
        _print_search(result, nested)


def _print_search(result: dict[str, Any], nested: bool) -> None:
    winner, label = result["winner"], "{name}/{version}".format(**result["model"])
    width = max(len(rank["extractor"]) for rank in result["ranks"])
    print(f"{'extractor':<{width}}  features      score  below the best")
    for rank in result["ranks"]:
        mark = " within reach of the best" if rank["within_reach"] else ""
        if rank["extractor"] == winner["extractor"]:
            mark = " <- winner"
        print(
            f"{rank['extractor']:<{width}}  {rank['features']:>8}  {rank['score']:.3f} ± "
            f"{rank['standard_error']:.3f}  {rank['shortfall']:.3f} ± "
            f"{rank['shortfall_error']:.3f}{mark}"
        )
    for name, fault in result["faults"].items():
        print(f"{name}: not tried: {fault}")
    print(f"{label} (alias challenger): {winner['extractor']}, {_RULE}")
    print(f"  {result['selection']}")
    left = result["trials"] - result["tried"] - len(result["faults"])
    if left:
        print(f"  {result['tried']} of {result['trials']} tried; the same command tries the rest.")
    elif nested and result["nested"] is None:
        print("  --nested is not finished; the same command goes on with it.")
    print(f"  spec: --extractor spec:{result['winner_file']}")
