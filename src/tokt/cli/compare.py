"""`tokt compare` and `tokt evaluate`: models side by side, or one against labels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tokt.features.common.errors import ToktError

from .dataset import labelled_missions
from .options import (
    DEFAULT_WORKSPACE,
    FramesOption,
    JsonOption,
    LabelFilesOption,
    MissionsOption,
    ModelArgument,
    PatchesOption,
    TaxonomyOption,
    WorkspaceOption,
)
from .output import answer, figure, print_patches, progress, say
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle
    from tokt.training.compare.predictions import ComparedModels
    from tokt.training.datasets.mission_source import LabelledMission


def compare(
    models: Annotated[list[str], Argument(help="NAME, NAME@ALIAS, NAME/VERSION or a .tokt file.")],
    output: Annotated[Path | None, Option("-o", "--output", help="HTML report to write.")] = None,
    mission: MissionsOption = None,
    labels: LabelFilesOption = None,
    frames: Annotated[
        str | None, Option(help="Use these frames of it only, such as 1-99,132-246.")
    ] = None,
    learning_curve: Annotated[
        str | None,
        Option(metavar="MODEL", help="Model whose learning curve is drawn. Default: the best one."),
    ] = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Compare models: which is better, by how much, and is the difference real?

    On the patches that cross-validation held out, or on missions.
    """
    from tokt.features.common import atomic
    from tokt.models.registry.registry import Registry
    from tokt.training.compare.comparison import compare_models
    from tokt.training.compare.report import has_registry, log_comparison, report_html

    if output is not None and output.is_dir():
        raise ToktError(f"{output} is a folder; -o names the report's file")
    compared = compared_models(models, mission, labels, frames, taxonomy, workspace)
    result = compare_models(compared, workspace, progress, learning_curve)
    html = report_html(compared, result)
    if output is not None:
        atomic.write_text(output, html)
    answer(json, result, lambda: _print_comparison(result))
    if output is not None:
        say(f"report: {output}")
    if has_registry(workspace):
        say(f"MLflow run: {log_comparison(result, html, Registry(workspace))}")
    else:
        say(f"not logged: no registry in workspace {workspace}")


def compared_models(
    models: list[str],
    mission: list[Path] | None,
    labels: list[Path] | None,
    frames: str | None,
    taxonomy: Path | None,
    workspace: Path,
) -> ComparedModels:
    """Models on what cross-validation held out of all, or on missions."""
    from tokt.features.frames.mission import parse_frames
    from tokt.labels.taxonomy import load_taxonomy
    from tokt.models.registry.load import load_model
    from tokt.training.compare.held_out_predictions import check_different, read_held_out
    from tokt.training.compare.mission_predictions import predict_missions

    if not mission:
        if labels or frames or taxonomy:
            raise ToktError("--labels, --frames and --taxonomy go with --mission")
        return read_held_out(models, workspace)
    classes = load_taxonomy(workspace, taxonomy)
    wanted = parse_frames(frames) if frames else None
    bundles = [load_model(model, workspace) for model in models]
    check_different([bundle.label for bundle in bundles], [bundle.sha256 for bundle in bundles])
    missions = labelled_missions(mission, labels, workspace, classes, bundles[0].grid)
    _check_frames(frames, missions)
    return predict_missions(bundles, missions, classes, progress, wanted)


def _check_frames(frames: str | None, missions: Sequence[LabelledMission]) -> None:
    if frames and len(missions) > 1:
        raise ToktError("--frames goes with one mission")


def _print_comparison(result: dict[str, Any]) -> None:
    print(f"on {result['what']} ({result['mode']}; {result['blocks']} {result['unit']})")
    for model in result["models"]:
        patch, frames, spread = model["patch"], model["frames"], model["intervals"]
        bounds = spread.get("f1")
        between = f" ({figure(bounds['low'])} to {figure(bounds['high'])})" if bounds else ""
        print(
            f"  {model['model']}: F1 {figure(patch['f1'])}{between}, precision "
            f"{figure(patch['precision'])}, recall {figure(patch['recall'])}, AP "
            f"{figure(patch['average_precision'])}, macro-F1 {figure(patch['macro_f1'])}, "
            f"{model['time']['median_ms']:.1f} ms a frame"
        )
        if frames is not None:
            print(
                f"    false status in {frames['false_status']} of {frames['ocean_frames']} ocean "
                f"frames, obstacle seen in {frames['detected']} of {frames['obstacle_frames']}, "
                f"first detection {', '.join(map(_first, frames['sequences']))}"
            )
    for line in (*result["words"], *result["learning_curve"].get("words", [])):
        print(line)
    for note in result["notes"]:
        say(f"note: {note}")


def _first(sequence: dict[str, Any]) -> str:
    found = sequence["first_detection"]
    early = " (before any labelled obstacle)" if sequence["false"] else ""
    return f"{'none' if found is None else found}{early}"


def evaluate(
    model: ModelArgument,
    mission: MissionsOption = None,
    labels: LabelFilesOption = None,
    patches: PatchesOption = None,
    frames: FramesOption = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Score a model on labelled missions, or on ready-cut patches.

    Patches, frame statuses, first detection; several missions also by dive and site.
    """
    from tokt.features.frames.mission import parse_frames
    from tokt.labels.taxonomy import load_taxonomy
    from tokt.models.registry.load import load_model
    from tokt.training.evaluation.evaluate import evaluate as evaluate_task
    from tokt.training.evaluation.evaluate import evaluate_patches

    if bool(mission) == bool(patches):
        raise ToktError("give either --mission DIR or --patches DIR")
    if patches and (labels or frames):
        raise ToktError(
            "--patches has its labels in its folder names; --labels and --frames go with --mission"
        )
    classes = load_taxonomy(workspace, taxonomy)
    wanted = parse_frames(frames) if frames else None
    bundle = load_model(model, workspace)
    if patches:
        result = evaluate_patches(bundle, patches, classes, progress)
    else:
        missions = labelled_missions(mission or [], labels, workspace, classes, bundle.grid)
        _check_frames(frames, missions)
        result = evaluate_task(bundle, missions, classes, progress, wanted)
    dives = result.get("missions", [])
    if result["seen_in_training"]:
        names = ", ".join(one["mission"] for one in dives if one["seen_in_training"])
        say(
            f"WARNING: the model learnt from {result['seen_in_training']} of these "
            f"{'patches' if patches else 'frames'}{f' ({names})' if names else ''}: "
            "these are training figures, not a test"
        )
    elif result.get("mission_in_training"):
        names = ", ".join(one["mission"] for one in dives if one["mission_in_training"])
        say(
            f"note: the model learnt from other frames of {names or 'this mission'}; another dive "
            "can go much worse than these figures"
        )
    answer(json, result, lambda: _print_evaluation(bundle, result))


def _print_evaluation(bundle: Bundle, result: dict[str, Any]) -> None:
    patch, missions = result["patch"], result.get("missions", [])
    where = result.get("mission") or result.get("patches") or f"{len(missions)} missions"
    print(
        f"{bundle.label} on {where}: {patch['n']} patches, "
        f"{result['unsure_ignored']} unsure ones ignored"
    )
    print_patches(patch)
    for label, seen in patch["by_label"].items():
        print(f"    {label}: {figure(seen['right_side'])} of {seen['n']} on the right side")
    if patch["reliability"]:
        print("  obstacle labels by decision value, which is no probability:")
    for one in patch["reliability"]:
        between = f"{one['low']:.2f} to {one['high']:.2f}"
        print(f"    {between:>16}: {figure(one['obstacle'])} of {one['n']}")
    if "frames" not in result:
        return
    frames = result["frames"]
    print(f"  status 1 with {bundle.operating_point.rule.words()}")
    held = frames["held_status"]
    print(
        f"  false status in {frames['false_status']} of {frames['ocean_frames']} ocean frames"
        + (f"; in {held} more it was held after an obstacle had left, by the rule" if held else "")
    )
    print(f"  obstacle seen in {frames['detected']} of {frames['obstacle_frames']} obstacle frames")
    print(f"  status unknown in {frames['unknown']} of {frames['n']} frames")
    if not missions:
        print(f"  first of three frames in a row with status 1: {frames['first_detection']}")
        return
    rows = [(one["mission"], one) for one in missions]
    rows += [(f"site {name}", one) for name, one in result["sites"].items()]
    width = max(len(name) for name, _ in rows)
    print(
        f"  {'':{width}}  patches     F1  precision  recall     AP  false/ocean  held  "
        "seen/obstacle  unknown  first of three"
    )
    for name, one in rows:
        patch, frames = one["patch"], one["frames"]
        false = f"{frames['false_status']}/{frames['ocean_frames']}"
        seen = f"{frames['detected']}/{frames['obstacle_frames']}"
        first = frames["first_detection"]
        at = "-" if first is None else "" if isinstance(first, dict) else first
        print(
            f"  {name:{width}}  {patch['n']:7}  {figure(patch['f1']):>5}  "
            f"{figure(patch['precision']):>9}  {figure(patch['recall']):>6}  "
            f"{figure(patch['average_precision']):>5}  {false:>11}  {frames['held_status']:4}  "
            f"{seen:>13}  {frames['unknown']:7}  {at}"
        )
