"""`tokt compare` and `tokt evaluate`: models side by side, or one against labels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tokt.features.common.terminal import say
from tokt.features.common.workspace import DEFAULT_WORKSPACE
from tokt.inference.reason import unknown_in_words

from .options import (
    FixedBoundaryOption,
    FramesOption,
    JsonOption,
    LabelFilesOption,
    MissionsOption,
    ModelArgument,
    PatchesOption,
    ReportOption,
    SharpFramesOption,
    TaxonomyOption,
    WorkspaceOption,
    fields_of,
)
from .output import answer, figure, print_at_sea, print_patches, progress, scores, unseen_in_words
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle

RateOption = Annotated[
    float | None,
    Option(
        help="Frames a second of the missions, to tell false statuses by the hour and times to "
        "contact."
    ),
]
StoppingOption = Annotated[
    float | None,
    Option(help="Distance in which the vehicle stops, to judge each approach's first status by."),
]
CalibrationOption = Annotated[
    Path | None, Option(help="Calibration of the missions' cameras, to measure distances.")
]
LogOption = Annotated[
    Path | None,
    Option(metavar="FILE.jsonl", help="Log of a run over the mission, for distances and times."),
]


def compare(
    models: Annotated[
        list[str],
        Argument(help="Models: NAME, NAME@ALIAS, NAME/VERSION, a .tokt file or a store's folder."),
    ],
    output: ReportOption = None,
    mission: MissionsOption = None,
    labels: LabelFilesOption = None,
    frames: FramesOption = None,
    rate: RateOption = None,
    stopping_distance: StoppingOption = None,
    calibration: CalibrationOption = None,
    log: LogOption = None,
    learning_curve: Annotated[
        str | None, Option(help="Model whose learning curve is drawn. Default: the best one.")
    ] = None,
    ceilings: Annotated[
        bool,
        Option(
            "--ceilings",
            help="For development: judge the same folds by gradient boosting, too, and by a small "
            "net on the pixels if torch is installed.",
        ),
    ] = False,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Compare models: which is better, and is the difference real?

    Models are compared on the patches that cross-validation held out, or on missions.
    """
    given = fields_of(locals())
    from tokt.training.compare.compare_options import CompareOptions
    from tokt.training.compare.compare_options import compare as compared

    found = compared(CompareOptions(**given), progress=progress, notice=say)
    answer(json, found.figures, lambda: _print_comparison(found.figures))
    if output is not None:
        say(f"report: {output}")
    run = found.log()
    say(f"MLflow run: {run}" if run else f"not logged: no registry in workspace {workspace}")


def _print_comparison(result: dict[str, Any]) -> None:
    print(f"on {result['what']} ({result['mode']}; {result['blocks']} {result['unit']})")
    for model in result["models"]:
        patch, frames, spread = model["patch"], model["frames"], model["intervals"]
        bounds = spread.get("f1")
        between = f" ({figure(bounds['low'])} to {figure(bounds['high'])})" if bounds else ""
        print(
            f"  {model['model']}: {scores(patch, between)}, macro-F1 {figure(patch['macro_f1'])}, "
            f"{model['time']['median_ms']:.1f} ms a frame"
        )
        if unseen := model["unseen"]:
            print(f"    {unseen_in_words(unseen)}")
        if frames is not None:
            print(
                f"    false status in {frames['false_status']} of {frames['ocean_frames']} ocean "
                f"frames, obstacle seen in {frames['detected']} of {frames['obstacle_frames']}, "
                f"first detection {', '.join(map(_first, frames['sequences']))}"
            )
            print_at_sea(frames, "    ")
    for one in result["ceilings"]:
        of = f" on the features of {one['model']}" if one["model"] else ""
        patch, found = one.get("patch"), one.get("missing")
        found = found or f"{scores(patch)}, macro-F1 {figure(patch['macro_f1'])}"
        print(f"  ceiling, {one['learner']}{of}: {found}")
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
    rate: RateOption = None,
    stopping_distance: StoppingOption = None,
    calibration: CalibrationOption = None,
    log: LogOption = None,
    fixed_boundary: FixedBoundaryOption = False,
    sharp_frames: SharpFramesOption = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Score a model on labelled missions, or on ready-cut patches.

    The figures are of patches, of frame statuses, and of each approach: the distance and time left
    at its first status. Several missions have them by dive and site, too.
    """
    given = fields_of(locals())
    from tokt.training.evaluation.evaluate_options import EvaluateOptions
    from tokt.training.evaluation.evaluate_options import evaluate as evaluated

    bundle, figures = evaluated(EvaluateOptions(**given), progress=progress, notice=say)
    answer(json, figures, lambda: _print_evaluation(bundle, figures))


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
    unknown, seen = frames["missed_unknown"], f"{frames['detected']} of {frames['obstacle_frames']}"
    judged = f"; {unknown} of the others are unknown, whatever their patches say" if unknown else ""
    print(f"  obstacle seen in {seen} obstacle frames{judged}")
    print(f"  status unknown in {frames['unknown']} of {frames['n']} frames")
    for line in unknown_in_words(frames["unknown_reasons"]):
        print(f"    {line}")
    print_at_sea(frames, "  ")
    if not missions:
        first = frames["first_detection"]
        if frames["single_pictures"]:
            return
        where = f"from frame {first} on" if first is not None else "never"
        print(f"  status 1 in three frames in a row: {where}")
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
