"""Predictions of models on labelled missions that none of them learnt from."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import pixel_sha256
from tokt.features.frames.mission import LEFT, Mission, chosen_frames, format_frames
from tokt.features.frames.single_pictures import why_single_pictures
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.texture.detector import TextureDetector, min_mask_patches
from tokt.labels.merge import merge_annotators
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.models.bundle.bundle import Bundle, frame_id
from tokt.models.operating_point import MAX_WINDOW, missed_before
from tokt.training.datasets.dataset import FRAME_KEY, PATCH_COLUMNS
from tokt.training.datasets.dive_positions import independent_blocks
from tokt.training.datasets.folds import BLOCK_FRAMES
from tokt.training.datasets.mission_source import LabelledMission
from tokt.training.datasets.split import blocks_of
from tokt.training.evaluation.approaches import NOTHING_STATED, AtSea, known_distances
from tokt.training.evaluation.evaluate import (
    classes_and_targets,
    frame_kinds,
    mission_in_training,
    unjudged_values,
)

from .frames import NEITHER, OBSTACLE_FRAME, OCEAN, FrameSeries, labelled_approaches
from .predictions import MISSION, ComparedModels, ModelPredictions, error_margins


def _check_grids(bundles: Sequence[Bundle]) -> None:
    first = bundles[0]
    for bundle in bundles:
        if bundle.grid != first.grid:
            raise ToktError(
                f"{first.label} judges patches of grid {first.grid}, {bundle.label} of "
                f"{bundle.grid}: they cannot be compared patch by patch"
            )


def check_unseen(
    bundles: Sequence[Bundle], mission: Mission, frames: Sequence[int], progress: Callable[..., Any]
) -> None:
    """Refuse, by ToktError, models that learnt from the very frames they would be compared on."""
    known = {bundle.label: set(bundle.content.trained_on.tolist()) for bundle in bundles}
    seen: dict[str, list[int]] = {bundle.label: [] for bundle in bundles}
    for number in progress(frames, len(frames), "looking for frames that were learnt from"):
        digest = int(frame_id(pixel_sha256(mission.read(number, LEFT))))
        for label, learnt in known.items():
            if digest in learnt:
                seen[label].append(number)
    faults = [
        f"{label} learnt from {len(numbers)} of the {len(frames)} frames "
        f"({format_frames(numbers)}) of {mission.name}"
        for label, numbers in seen.items()
        if numbers
    ]
    if faults:
        raise ToktError(
            f"refused: {'; '.join(faults)}; leave such frames out with --frames, or leave "
            "--mission out to compare what cross-validation held out"
        )


def _score(
    bundles: Sequence[Bundle], frames: Iterable[Frame]
) -> tuple[list[list[F64]], list[list[bool]], int]:
    """Each model's decision values of whole frames, and whether the runtime would judge these.

    The frames are of one run. And the patches that it takes to bring a mask's mean over the
    thesis's limit.
    """
    values: list[list[F64]] = [[] for _ in bundles]
    judged: list[list[bool]] = [[] for _ in bundles]
    runs = [SinglePolicy(TextureDetector(bundle)) for bundle in bundles]
    for frame in frames:
        for bundle, run, its_values, its_judged in zip(bundles, runs, values, judged, strict=True):
            found = run.judge(frame).decision_values
            its_judged.append(found is not None)
            its_values.append(unjudged_values(bundle, frame) if found is None else found)
    grid = bundles[0].grid
    assert frame.left is not None
    return values, judged, min_mask_patches(grid, *grid.resized(*frame.left.shape[:2]))


def _patches(
    records: Sequence[LabelRecord],
    missions: Mapping[str, Mission],
    blocks: Mapping[str, Mapping[int, str]],
    single_pictures: Collection[str],
) -> pd.DataFrame:
    rows = [(r.mission, r.camera, r.frame, r.row, r.col, str(r.label), r.mission) for r in records]
    patches = pd.DataFrame(rows, columns=PATCH_COLUMNS)
    patches["position"] = [missions[r.mission].place(r.frame) + 1 for r in records]
    groups = zip(patches.mission, patches.frame, blocks_of(patches, 1, ()), strict=True)
    patches["group"] = [
        alone if mission in single_pictures else blocks[mission][frame]
        for mission, frame, alone in groups
    ]
    return patches


def _frames(
    name: str,
    mission: Mission,
    blocks: Mapping[int, str],
    frames: Sequence[int],
    records: Sequence[LabelRecord],
    taxonomy: Taxonomy,
    n: int,
) -> pd.DataFrame:
    kinds = dict.fromkeys(frames, NEITHER)
    sides = frame_kinds(frames, records, taxonomy, n)
    for kind, numbers in zip((OCEAN, OBSTACLE_FRAME), sides, strict=True):
        kinds |= dict.fromkeys(numbers, kind)
    rows = [
        (name, LEFT, number, mission.place(number) + 1, kind, -1, blocks[number])
        for number, kind in kinds.items()
    ]
    return pd.DataFrame(rows, columns=[*FRAME_KEY, "position", "kind", "fold", "block"])


def _predictions(
    bundle: Bundle,
    patches: pd.DataFrame,
    truth: Bools,
    places: I64,
    of_frames: Sequence[F64],
    judged: Sequence[bool],
    white: int,
) -> ModelPredictions:
    """A model on the patches of a table; `places` is each one's frame among those scored."""
    cell = (patches.row * bundle.grid.cols + patches.col).to_numpy()
    values, model = np.stack(of_frames)[places, cell], bundle.model
    scores = np.stack([model.obstacle_score(frame) for frame in of_frames])
    classes, targets = classes_and_targets(model, patches.label.tolist(), truth)
    return ModelPredictions(
        bundle=bundle,
        targets=targets,
        predicted=model.predicted(values),
        classes=classes,
        error_margin=error_margins(model, values, targets),
        score=model.obstacle_score(values),
        # A masked patch has no value, and exceeds no margin.
        on_grid=np.where(np.isnan(scores), -np.inf, scores),
        white=white,
        judged=np.array(judged, bool),
        fold_rules=None,
        split=str(bundle.content.metrics.get("split", "")),
    )


def predict_missions(
    bundles: Sequence[Bundle],
    missions: Sequence[LabelledMission],
    taxonomy: Taxonomy,
    progress: Callable[..., Any],
    frames: Sequence[int] | None = None,
    stated: AtSea = NOTHING_STATED,
) -> ComparedModels:
    """Bring models together on the left frames of missions, or on some `frames` of them.

    Labels are in the models' grid; several annotators are merged. `stated` is as for
    `tokt.training.evaluation.evaluate.evaluate_missions`.

    Raises ToktError if a model learnt from one of the frames, the grids differ, or nothing is
    labelled.
    """
    _check_grids(bundles)
    sure: list[LabelRecord] = []
    keys: list[tuple[str, int]] = []
    missed: list[int] = []
    tables, what, unsure, ranges = [], [], 0, {}
    blocks: dict[str, dict[int, str]] = {}
    labelled = {one.name: one for one in missions}
    by_name = {name: labelled[name].mission for name in sorted(labelled)}
    for name, mission in by_name.items():
        numbers = chosen_frames(mission, frames, LEFT)
        wanted = set(numbers)
        used = (r for r in labelled[name].records if r.camera == LEFT and r.frame in wanted)
        merged = merge_annotators(used).records
        mine = [record for record in merged if record.label != UNSURE]
        if not mine:
            raise ToktError(f"no labelled patch of mission {mission.name!r} to compare on")
        check_unseen(bundles, mission, sorted({record.frame for record in mine}), progress)
        in_view = labelled[name].patches_in_view(bundles[0].grid)
        blocks[name] = independent_blocks(mission, numbers)
        table = _frames(name, mission, blocks[name], numbers, merged, taxonomy, in_view)
        ranges[name] = known_distances(mission, labelled_approaches(table), stated, progress)
        tables.append(table)
        in_dive = [mission.place(number) for number in numbers]
        missed += [MAX_WINDOW, *missed_before(in_dive, 1)[1:]]  # each mission is a run
        keys += [(name, number) for number in numbers]
        what.append(f"mission {mission.name}, frames {format_frames(numbers)}")
        sure, unsure = sure + mine, unsure + len(merged) - len(mine)
    single = [name for name, mission in by_name.items() if why_single_pictures(mission)]
    patches = _patches(sure, by_name, blocks, single)
    truth = np.array([taxonomy.is_obstacle(label) for label in patches.label], bool)
    scored = progress(keys, len(keys), "scoring")
    run = (
        Frame(number, 0.0, dive.read(number, LEFT), None, missed=gap, masks=dive.masks)
        for (name, number), gap in zip(scored, missed, strict=True)
        for dive in [by_name[name]]
    )
    values, judged, white = _score(bundles, run)
    place = {key: index for index, key in enumerate(keys)}
    places = np.array([place[record.mission, record.frame] for record in sure])
    return ComparedModels(
        mode=MISSION,
        what="; ".join(what),
        patches=patches,
        truth=truth,
        models=[
            _predictions(bundle, patches, truth, places, its_values, its_judged, white)
            for bundle, its_values, its_judged in zip(bundles, values, judged, strict=True)
        ],
        series=FrameSeries.of(pd.concat(tables), step=1),
        read_frame=lambda name, camera, frame: by_name[name].read(frame, camera),
        dataset=None,
        notes=_notes(bundles, sure, unsure, single),
        stated=stated,
        ranges=ranges,
    )


def _notes(
    bundles: Sequence[Bundle], sure: Sequence[LabelRecord], unsure: int, single: Collection[str]
) -> list[str]:
    alone = f", and each picture of {', '.join(single)}" if single else ""
    notes = [
        "No model learnt from any of these frames: they were compared pixel by pixel with what "
        f"each model learnt from. {unsure} patches marked unsure are not scored. Each frame is "
        "judged at the frame rule in the model's bundle. Blocks of "
        f"{BLOCK_FRAMES} frames, or as long as the scene stays the same, count as "
        f"independent{alone}."
    ]
    same = [bundle.label for bundle in bundles if mission_in_training(bundle, sure)]
    if same:
        notes.append(
            f"WARNING: {', '.join(same)} learnt from other frames of this very mission, which "
            "flatters against a model that did not; another dive can go much worse."
        )
    return notes
