"""Score a model on a mission and its labels: patches, frames, and when it first warns."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.features.frames.image_file import decode_image, pixel_sha256
from tokt.features.frames.mission import LEFT, Mission, chosen_frames
from tokt.features.frames.single_pictures import why_single_pictures
from tokt.features.frames.view_mask import Box, boxes_of
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import OBSTACLE, UNKNOWN, Verdict
from tokt.labels.merge import merge_annotators
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.bundle.bundle import Bundle, frame_id
from tokt.models.linear import LinearModel
from tokt.models.operating_point import missed_before
from tokt.training.datasets.dataset import CLEAR
from tokt.training.datasets.dataset import OBSTACLE as OBSTACLE_CLASS
from tokt.training.datasets.dive_positions import independent_blocks
from tokt.training.datasets.mission_source import (
    PATCH_GRID,
    LabelledMission,
    label_of,
    patch_images,
)

from .approaches import (
    NOTHING_STATED,
    AtSea,
    approach_figures,
    approaches,
    false_status_per_hour,
    known_distances,
)
from .metrics import class_metrics, obstacle_metrics, reliability


@dataclass(frozen=True)
class ScoredMission:
    """A model's values and verdicts of one mission, frame by frame."""

    frames: list[int]  # frame numbers in order
    missed: list[int]  # frames of the mission between the one scored before and this one
    values: F64  # (n_frames, n_patches, n_outputs)
    verdicts: list[Verdict]  # the runtime's own, at the operating point
    seen_in_training: list[int]  # frames whose very pixels the model learnt from

    @property
    def status(self) -> list[int]:
        """1 obstacle, 0 clear, -1 unknown."""
        return [verdict.status for verdict in self.verdicts]

    @property
    def mean(self) -> list[float]:
        """Mean of the 0/255 mask; NaN where the verdict is unknown."""
        return [np.nan if verdict.mean is None else verdict.mean for verdict in self.verdicts]


def score_mission(
    bundle: Bundle,
    mission: Mission,
    progress: Callable[..., Any],
    frames: Sequence[int] | None = None,
) -> ScoredMission:
    """Run a model over the left frames of a mission, as one run of the runtime does.

    The frame rule sees the frames in their order; where frames are missing between them, or were
    not asked for, what it did not see is unknown to it.

    Raises ToktError if a frame cannot be read, or its patches cannot be described.
    """
    numbers = chosen_frames(mission, frames, LEFT)
    missed = missed_before([mission.place(number) for number in numbers], 1)
    known = set(bundle.content.trained_on.tolist())
    policy = SinglePolicy(TextureDetector(bundle))
    values, verdicts, seen = [], [], []
    for index, number in enumerate(progress(numbers, len(numbers), "scoring")):
        image = mission.read(number, LEFT)
        frame = Frame(number, 0.0, image, None, missed=missed[index], masks=mission.masks)
        judgement = policy.judge(frame)
        decided = judgement.decision_values
        values.append(unjudged_values(bundle, frame) if decided is None else decided)
        verdicts.append(judgement.verdict)
        if int(frame_id(pixel_sha256(image))) in known:
            seen.append(number)
    return ScoredMission(numbers, missed, np.stack(values), verdicts, seen)


def unjudged_values(bundle: Bundle, frame: Frame) -> F64:
    """What the model says of an unknown frame's patches; ToktError if they cannot be described."""
    picture = frame.covered.left
    assert picture is not None
    try:
        return bundle.values_alone(bundle.features(picture))
    except (ToktError, ValueError) as error:
        raise ToktError(
            f"frame {frame.number} cannot be scored: {error} (--frames leaves it out)"
        ) from None


def first_detection(frames: list[int], missed: list[int], status: list[int]) -> int | None:
    """The first of three frames with status 1 that follow each other (thesis chapter 5), or None.

    Of frames, missed and status as in `ScoredMission`; those on both sides of missing ones do not
    follow each other.
    """
    for i in range(len(frames) - 2):
        if not any(missed[i + 1 : i + 3]) and status[i : i + 3] == [OBSTACLE] * 3:
            return frames[i]
    return None


def _held(bundle: Bundle, scored: ScoredMission, obstacle: set[int]) -> set[int]:
    """Frames that show nothing, whose status is the frame rule's memory of obstacle frames."""
    rule = bundle.operating_point.rule
    held, last, place = set(), -rule.n, 0
    for index, number in enumerate(scored.frames):
        place += 1 + scored.missed[index]
        if number in obstacle:
            last = place
        over = bundle.model.obstacle_score(scored.values[index]) > rule.margin
        if scored.status[index] == OBSTACLE and not over.any() and 0 < place - last < rule.n:
            held.add(number)
    return held


def frame_kinds(
    frames: Sequence[int], records: Iterable[LabelRecord], taxonomy: Taxonomy, n_patches: int
) -> tuple[list[int], list[int]]:
    """Ocean frames and obstacle frames, by the merged labels of these frames.

    An *obstacle frame* has a patch labelled as an obstacle. An *ocean frame* has every patch
    labelled, all of them clear. A frame with neither (an `unsure` patch, or patches without a
    label, and no sure obstacle) is not judged.
    """
    labels: dict[int, list[str | None]] = {number: [] for number in frames}
    for record in records:
        labels[record.frame].append(record.label)
    ocean, obstacle = [], []
    for number, names in labels.items():
        sides = [label != UNSURE and taxonomy.is_obstacle(str(label)) for label in names]
        if any(sides):
            obstacle.append(number)
        elif len(names) == n_patches and UNSURE not in names:
            ocean.append(number)
    return ocean, obstacle


def unknown_reasons(verdicts: Iterable[Verdict]) -> dict[str, int]:
    """How many verdicts are unknown, by the code of their reason."""
    counts = Counter(one.reason.value for one in verdicts if one.status == UNKNOWN)
    return dict(sorted(counts.items()))


def _frame_figures(
    bundle: Bundle, scored: ScoredMission, ocean: list[int], obstacle: list[int], mission: Mission
) -> dict[str, Any]:
    """Statuses against what the labels say a frame holds (`frame_kinds`).

    In an ocean frame that shows no patch over the margin the rule may still hold a status on to
    what the labels say was there up to n - 1 frames before: a *held* status, which is no false one.
    """
    said = scored.status
    status = dict(zip(scored.frames, said, strict=True))
    memory = _held(bundle, scored, set(obstacle))
    false = [number for number in ocean if status[number] == OBSTACLE and number not in memory]
    held = [number for number in ocean if number in memory]
    missed = [number for number in obstacle if status[number] != OBSTACLE]
    blocks = independent_blocks(mission, scored.frames)
    return {
        "n": len(scored.frames),
        "ocean_frames": len(ocean),
        "false_status": len(false),
        "false_status_frames": false,
        "ocean_blocks": len({blocks[number] for number in ocean}),
        "false_status_blocks": len({blocks[number] for number in false}),
        "held_status": len(held),
        "held_status_frames": held,
        "obstacle_frames": len(obstacle),
        "detected": len(obstacle) - len(missed),
        "missed_frames": missed,
        "missed_unknown": sum(status[number] == UNKNOWN for number in missed),
        "first_obstacle_frame": obstacle[0] if obstacle else None,
        "first_detection": first_detection(scored.frames, scored.missed, said),
        "unknown": said.count(UNKNOWN),
        "unknown_reasons": unknown_reasons(scored.verdicts),
        "not_judged": len(scored.frames) - len(ocean) - len(obstacle),
    }


def classes_and_targets(
    model: LinearModel, labels: Sequence[str], truth: Bools
) -> tuple[tuple[str, ...], I64]:
    """A model's classes, with what else was labelled, and each label's index among them.

    Of a model that tells obstacles from clear water a label counts as its side, in `truth`.
    """
    if model.classes == (CLEAR, OBSTACLE_CLASS):
        labels = [OBSTACLE_CLASS if side else CLEAR for side in truth]
    classes = (*model.classes, *sorted(set(labels) - set(model.classes)))
    order = {name: index for index, name in enumerate(classes)}
    return classes, np.array([order[label] for label in labels], np.int64)


def _patch_figures(
    model: LinearModel, values: F64, labels: list[str], taxonomy: Taxonomy
) -> dict[str, Any]:
    truth = np.array([taxonomy.is_obstacle(label) for label in labels])
    predicted, score = model.predicted(values), model.obstacle_score(values)
    classes, targets = classes_and_targets(model, labels, truth)
    right = np.asarray(model.obstacle, bool)[predicted] == truth
    return {
        "n": len(labels),
        **obstacle_metrics(truth, score),
        **class_metrics(targets, predicted, classes),
        "reliability": reliability(truth, score),
        "by_label": {
            label: {"n": int(mine.sum()), "right_side": float(right[mine].mean())}
            for label in sorted(set(labels))
            for mine in [np.array(labels) == label]
        },
    }


@dataclass(frozen=True)
class _Part:
    """What a model says of one mission's labelled patches and frames."""

    name: str
    site: str
    values: F64
    labels: list[str]
    frames: dict[str, Any]
    unsure: int
    seen: int
    known: bool
    always_alarming: list[Box]


_FEWEST_CLEAR = 10  # frames in which a patch is labelled clear
_NEARLY_ALL = 0.9  # of these
_MOST_MASKED = 0.3  # of the patches


def _always_alarming(bundle: Bundle, score: F64, obstacle: Bools, cell: I64) -> list[Box]:
    """The patches that alarm in nearly all frames of open water, as boxes of a mask.

    Nearly always it is not the water: a burned-in clock, a rim, a part of the vehicle.
    """
    grid, alarms = bundle.grid, score > 0
    clear = np.bincount(cell[~obstacle], minlength=grid.n_patches)
    wrong = np.bincount(cell[~obstacle & alarms], minlength=grid.n_patches)
    patches = (clear >= _FEWEST_CLEAR) & (wrong >= _NEARLY_ALL * clear)
    if patches.mean() > _MOST_MASKED:  # the model does not know this water
        return []
    return list(boxes_of(patches.reshape(grid.rows, grid.cols)))


def _part(
    bundle: Bundle,
    scored: ScoredMission,
    one: LabelledMission,
    taxonomy: Taxonomy,
    stated: AtSea,
    progress: Callable[..., Any],
) -> _Part:
    name, wanted = one.mission.name, set(scored.frames)
    merged = merge_annotators(r for r in one.records if r.camera == LEFT and r.frame in wanted)
    sure = [record for record in merged.records if record.label != UNSURE]
    if not sure:
        raise ToktError(f"no labelled patch of mission {name!r} to evaluate on")
    position = {number: index for index, number in enumerate(scored.frames)}
    frame = np.array([position[record.frame] for record in sure])
    cell = np.array([record.row * bundle.grid.cols + record.col for record in sure])
    in_view = one.patches_in_view(bundle.grid)
    ocean, obstacle = frame_kinds(scored.frames, merged.records, taxonomy, in_view)
    figures = _frame_figures(bundle, scored, ocean, obstacle, one.mission)
    spans = approaches(scored.frames, set(ocean), set(obstacle))
    ranges = known_distances(one.mission, spans, stated, progress)
    series = scored.frames, scored.missed, scored.status
    if single := bool(why_single_pictures(one.mission)):
        figures["first_detection"] = None
    figures["single_pictures"] = single
    figures["approaches"] = approach_figures(*series, spans, ranges, stated.stopping_m)
    values = scored.values[frame, cell]
    obstacle_labels = np.array([taxonomy.is_obstacle(str(record.label)) for record in sure], bool)
    score = bundle.model.obstacle_score(values)
    return _Part(
        name,
        one.site,
        values,
        [str(record.label) for record in sure],
        figures,
        len(merged.records) - len(sure),
        len({*scored.seen_in_training} & {record.frame for record in sure}),
        mission_in_training(bundle, one.records),
        _always_alarming(bundle, score, obstacle_labels, cell),
    )


def _together(
    bundle: Bundle,
    parts: Sequence[_Part],
    taxonomy: Taxonomy,
    frames: dict[str, Any],
    rate: float | None,
) -> dict[str, Any]:
    """The figures of some missions' patches as if they were of one."""
    hourly = false_status_per_hour(
        frames["false_status"],
        frames["ocean_frames"],
        frames["false_status_blocks"],
        frames["ocean_blocks"],
        rate,
    )
    values = np.concatenate([part.values for part in parts])
    labels = [label for part in parts for label in part.labels]
    return {
        "patch": _patch_figures(bundle.model, values, labels, taxonomy),
        "frames": {**frames, "false_status_per_hour": hourly},
        "unsure_ignored": sum(part.unsure for part in parts),
        "seen_in_training": sum(part.seen for part in parts),
        "mission_in_training": any(part.known for part in parts),
        "always_alarming": {part.name: part.always_alarming for part in parts},
    }


def _all_frames(parts: Sequence[_Part]) -> dict[str, Any]:
    """Counts added up, frames by ``mission:frame``, what is the first one by mission."""
    pooled: dict[str, Any] = {}
    for key, value in parts[0].frames.items():
        found = {part.name: part.frames[key] for part in parts}
        if key.startswith("first_"):
            pooled[key] = found
        elif key == "approaches":
            pooled[key] = [
                {"mission": name, **one} for name, those in found.items() for one in those
            ]
        elif key == "unknown_reasons":
            pooled[key] = dict(sum(map(Counter, found.values()), Counter()))
        elif isinstance(value, list):
            pooled[key] = [f"{name}:{number}" for name, those in found.items() for number in those]
        else:
            pooled[key] = sum(found.values())
    return pooled


def _model(bundle: Bundle) -> dict[str, Any]:
    return {
        "name": bundle.name,
        "version": bundle.version,
        "sha256": bundle.sha256,
        "dataset_hash": bundle.content.provenance.get("dataset_hash"),
    }


def mission_in_training(bundle: Bundle, records: Sequence[LabelRecord]) -> bool:
    """Whether the model learnt from frames of the very missions it is scored on.

    Blocks held back from a dive flatter a model even where no frame was seen twice.
    """
    learnt = bundle.content.provenance.get("trained_frames", {})
    return isinstance(learnt, dict) and any(record.mission in learnt for record in records)


def evaluate_missions(
    bundle: Bundle,
    missions: Sequence[LabelledMission],
    taxonomy: Taxonomy,
    progress: Callable[..., Any],
    frames: Sequence[int] | None = None,
    stated: AtSea = NOTHING_STATED,
    scored: ScoredMission | None = None,
) -> dict[str, Any]:
    """Score a model on labelled missions.

    Parameters
    ----------
    missions : sequence of LabelledMission
        With labels in the model's grid; several annotators are merged.
    frames : sequence of int, optional
        Judge these frames only.
    stated : AtSea
        Rate, stopping distance, and where distances come from; a log is of one mission.
    scored : ScoredMission, optional
        A single mission that has been scored already.

    Returns
    -------
    dict
        patch (n, precision, recall, f1, average_precision, per_class, confusion, by_label,
        reliability), frames (at the operating point: n, ocean_frames, false_status, held_status,
        detected, obstacle_frames,
        unknown_reasons, first_detection, approaches as `approach_figures` has them,
        false_status_per_hour, ...), operating_point, latency_frames (from
        the first alarm to the first status at the least), unsure_ignored, seen_in_training
        (frames whose very pixels were learnt from), mission_in_training, always_alarming (by
        mission boxes of patches that alarm in nearly all frames of open water), model.
        Of one mission its name, `mission`. Of several all this is of them together, with the same
        figures of each in a list `missions`, and by `sites` where these are known.

    Raises
    ------
    ToktError
        If no labelled patch of a mission is left to judge.
    """
    point, rate, parts = bundle.operating_point, stated.frames_per_second, []
    for one in missions:
        found = scored or score_mission(bundle, one.mission, progress, frames)
        parts.append(_part(bundle, found, one, taxonomy, stated, progress))
    rule = {"operating_point": point.to_json(), "latency_frames": point.rule.latency_frames}
    each = [
        {"mission": part.name, **_together(bundle, [part], taxonomy, part.frames, rate)}
        for part in parts
    ]
    if len(parts) == 1:
        return {"model": _model(bundle), **each[0], **rule}
    sites: dict[str, list[_Part]] = {}
    for part, figures in zip(parts, each, strict=True):
        figures["site"] = part.site or None
        if part.site:
            sites.setdefault(part.site, []).append(part)
    return {
        "model": _model(bundle),
        **_together(bundle, parts, taxonomy, _all_frames(parts), rate),
        **rule,
        "missions": each,
        "sites": {
            site: _together(bundle, dives, taxonomy, _all_frames(dives), rate)
            for site, dives in sorted(sites.items())
        },
    }


def evaluate_patches(
    bundle: Bundle, folder: Path, taxonomy: Taxonomy, progress: Callable[..., Any]
) -> dict[str, Any]:
    """Score a model of ready-cut patches on a folder with one sub-folder of images a class.

    Found are, as of `evaluate_missions`, model, patch, unsure_ignored, seen_in_training; and the
    folder, `patches`.

    Raises ToktError if the model judges the patches of frames, an image cannot be read or
    described, or none is labelled for sure.
    """
    if bundle.grid != PATCH_GRID:
        raise ToktError(
            f"{bundle.label} judges the patches of whole frames (grid {bundle.grid}), not "
            "ready-cut ones; evaluate it on a mission"
        )
    images = patch_images(folder, taxonomy)
    sure = [image for image in images if label_of(image) != UNSURE]
    if not sure:
        raise ToktError(f"no labelled patch in {folder} to evaluate on")
    known, seen, values = set(bundle.content.trained_on.tolist()), 0, []
    for path in progress(sure, len(sure), "scoring"):
        with os_errors_as(str(path), ToktError):
            image = decode_image(path.read_bytes(), str(path))
        try:
            values.append(bundle.decision_values(image))
        except (ToktError, ValueError) as error:
            raise ToktError(f"{path} cannot be scored: {error}") from None
        seen += int(frame_id(pixel_sha256(image))) in known
    labels = [label_of(image) for image in sure]
    return {
        "model": _model(bundle),
        "patches": str(folder),
        "patch": _patch_figures(bundle.model, np.concatenate(values), labels, taxonomy),
        "unsure_ignored": len(images) - len(sure),
        "seen_in_training": seen,
    }
