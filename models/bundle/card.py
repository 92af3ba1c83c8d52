"""The model card: what a bundle is, for the person who has to trust it."""

from collections.abc import Mapping, Sequence
from typing import Any

from tokt.features.extractors.spec import extractor_summary
from tokt.models.distribution import drift_words
from tokt.models.operating_point import OperatingPoint
from tokt.models.sight import sight_from_json, sight_words

_MAX_LIST = 12
_WORST_FOLDS = 2
_SENTENCES = ("words", "method", "novelty")
_SAY_NOTHING: tuple[Any, ...] = (None, "", "none", "None", {}, [], ())
"""Values that a card leaves out, with what they would be of."""
_NOT_LISTED = (
    *(*_SENTENCES, "candidates", "tail", "reachable", "confidence", "latency_frames"),
    "boundary",  # of the first models whose boundary moves: the words of their prior
)
_OF_DATA = (
    *("dataset", "dataset_hash", "dataset_sources"),
    *("missions", "label_counts", "trained_frames"),
)

_PATCH_FIGURES = {"f1": "obstacle patches: F1", "precision": "precision", "recall": "recall"} | {
    "average_precision": "average precision",
    "macro_f1": "macro-F1 over the classes",
}

INTENDED_USE = """Warns the pilot of an ROV, frame by frame, that the camera sees something that
is not open water. It is for frames of the camera, lamp and water of the missions below. Score it on
a labelled dive of your own (`tokt evaluate`) before you rely on it anywhere else."""

NOT_FOR = """- As the only guard of a vehicle: clear means that no patch looked like an obstacle the
  model learnt, not that there is none.
- Distances, sizes, or what the obstacle is.
- Frames that are too dark, saturated, damaged or of another shape: the runtime calls them
  unknown."""


def _figure(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        said = sorted((name, part) for name, part in value.items() if part is not None)
        return "; ".join(f"{name} {_text(part)}" for name, part in said)
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return _listed(value)
    return str(value)


def _listed(values: Sequence[Any]) -> str:
    """The first few, and how many more there are."""
    shown = ", ".join(str(value) for value in values[:_MAX_LIST])
    more = len(values) - _MAX_LIST
    return (f"{shown} and {more} more" if more > 0 else shown) or "no frame"


def _lines(values: Mapping[str, Any]) -> str:
    return "\n".join(
        f"- {key.replace('_', ' ')}: {_text(value)}"
        for key, value in sorted(values.items())
        if value not in _SAY_NOTHING
    )


def _sight(recipe: Mapping[str, Any]) -> str:
    grid = recipe["grid"]
    classes = ", ".join(
        f"{item['name']} ({'obstacle' if item['obstacle'] else 'clear'})"
        for item in recipe["classes"]
    )
    name, landmarks = recipe.get("extractor_name"), recipe.get("landmarks", 0)
    classifier = "linear (LinearSVC, scaler folded in), one matrix product"
    if landmarks:
        likeness = f"the likeness to {landmarks} landmarks (Nystroem, radial basis)"
        classifier = f"linear (LinearSVC) in {likeness}"
    resized = f"frames resized to width {grid['width']}" if grid["width"] else "ready-cut"
    return f"""- classes: {classes}
- grid: {grid["rows"]}x{grid["cols"]} patches, {resized}
- extractor: {f"`{name}`, " if name else ""}{recipe["dim"]} features a patch: \
{extractor_summary(recipe["extractor"])}
- classifier: {classifier}
- patch thresholds: {", ".join(f"{value:g}" for value in recipe["thresholds"])}"""


def _operating_point(point: OperatingPoint) -> str:
    rule = point.rule
    head = f"Status 1 with {rule.words()}; {rule.latency_words()}."
    moves = [point.water.words()] if point.water else []
    if not point.chosen:
        head += " It was not chosen for a stated rate of false statuses."
        return "\n\n".join([head, *moves])
    said = map(point.chosen.get, _SENTENCES)
    words = [sentence for sentence in said if sentence not in _SAY_NOTHING]
    rest = {key: value for key, value in point.chosen.items() if key not in _NOT_LISTED}
    return "\n\n".join(filter(None, [head, *words, *moves, _lines(rest)]))


def _table(metrics: Mapping[str, Any]) -> str:
    patch, frames = metrics.get("patch", {}), metrics.get("frames")
    rows = [(name, _figure(patch.get(key))) for key, name in _PATCH_FIGURES.items()]
    rows += [
        (f"F1 of class {name}", f"{_figure(one['f1'])} ({one['n']} patches)")
        for name, one in patch.get("per_class", {}).items()
    ]
    folds, dives = metrics.get("folds") or [], metrics.get("dives") or {}
    if dives:
        each = (f"{name} {_figure(one['f1'])}" for name, one in dives.items())
        rows.append(("F1 of the dives", ", ".join(each)))
    elif folds:
        rows.append(("F1 of the folds", ", ".join(_figure(fold["f1"]) for fold in folds)))
    if frames:
        false = _counts(frames["false_status"], frames["ocean_frames"])
        rows.append(("open-ocean frames with a false status", false))
    if frames and frames.get("false_status_per_hour"):
        hourly = frames["false_status_per_hour"]
        bound = hourly["upper_bound"]
        value = f"{hourly['false_status']:.3g}, at most {bound['of_frames']:.3g} with"
        value += f" {bound['confidence']:.0%} confidence, were frames independent"
        rows.append((f"false statuses in {hourly['in_frames']:,.0f} of them", value))
    if frames and "obstacle_frames" in frames:
        seen = _counts(frames["detected"], frames["obstacle_frames"])
        rows.append(("obstacle frames with status 1", seen))
    if frames and frames.get("obstacle_frames") and frames.get("first_detection"):
        first = {name: _or_never(at) for name, at in frames["first_detection"].items()}
        rows.append(("first of three frames in a row with status 1", _text(first)))
    if frames and "approaches" in frames:
        late = ", ".join(_lateness(one) for one in frames["approaches"])
        rows.append(("first status of each approach", late or "no approach in the labels"))
    return "\n".join(f"| {name} | {value} |" for name, value in rows)


def _lateness(approach: Mapping[str, Any]) -> str:
    where = "{mission} {first_obstacle_frame}".format(**approach)
    late = approach["frames_late"]
    return f"{where}: {_or_never(None if late is None else f'{late} frames late')}"


def _counts(some: int, of: int) -> str:
    return f"{some} of {of}" if of else "no such frame was labelled"


def _or_never(value: Any) -> Any:
    return "never" if value is None else value


def _failures(metrics: Mapping[str, Any]) -> str:
    frames = metrics.get("frames", {})
    folds = [fold for fold in metrics.get("folds", []) if fold["f1"] is not None]
    worst = sorted(folds, key=lambda fold: float(fold["f1"]))[:_WORST_FOLDS]
    lines = [
        f"- lowest fold: F1 {_figure(fold['f1'])} on frames {_shortened(fold['frames'])}"
        for fold in worst
        if "frames" in fold
    ]
    for key, of, what in (
        ("false_status_frames", "ocean_frames", "false status on open ocean"),
        ("missed_frames", "obstacle_frames", "an obstacle and no status 1"),
    ):
        if key in frames and frames.get(of):
            lines.append(f"- {what}: {_listed(frames[key])}")
    return "\n".join(lines) or "Not recorded."


def _stress(stress: Mapping[str, Any] | None) -> str:
    """What changed pictures of the same held-out frames do to it."""
    if not stress:
        return ""
    rows = "\n".join(
        f"| {name.replace('_', ' ')}{' (learnt from)' if one['learnt'] else ''} "
        f"| {_figure(one['f1'])} | {_figure(one['fall'])} "
        f"| {_counts(one['false_status'], one['ocean_frames'])} "
        f"| {_counts(one['detected'], one['obstacle_frames'])} |"
        for name, one in stress.items()
    )
    head = "| pictures changed by | F1 | falls by | false status | obstacle frames seen |"
    return f"\n\n{head}\n|---|---|---|---|---|\n{rows}"


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60].rsplit(',', 1)[0]}, ..."


def model_card(label: str, recipe: Mapping[str, Any], provenance: Mapping[str, Any]) -> str:
    """Markdown that follows from the recipe alone, so that it is the same at each export.

    The recipe is as `Registry.recipe` gives it: extractor, extractor_name (may be missing), dim,
    grid, classes, thresholds, metrics, operating_point (missing before recipe version 2),
    distribution (missing before 3) and sight (missing before 5). `label` is ``name/version``; the
    provenance has the MLflow run id.
    """
    metrics = recipe["metrics"]
    point = OperatingPoint()
    if "operating_point" in recipe:
        point = OperatingPoint.from_json(recipe["operating_point"])
    voided = metrics.get("voided")
    return f"""# {label}

{INTENDED_USE}

Not for:

{NOT_FOR}

## Data

{_lines({key: provenance.get(key) for key in _OF_DATA})}

## How it sees

{_sight(recipe)}

## Operating point

{_operating_point(point)}

## What was measured

{f"{voided} " if voided else ""}{metrics.get("split", "Not recorded.")}

| figure | value |
|---|---|
{_table(metrics)}

Patch figures are at the patch thresholds, frame figures at the operating point. All come from
the missions named above: another dive, lamp, camera or water can differ much.

## Known failures, in that measurement

{_failures(metrics)}{_stress(metrics.get("stress"))}

## Input drift

{drift_words(recipe.get("distribution"))}

## Sight

{sight_words(sight_from_json(recipe["sight"]) if "sight" in recipe else ())}

## Lineage

{_lines({key: value for key, value in provenance.items() if key not in _OF_DATA})}
"""
