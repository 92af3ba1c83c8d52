"""Predictions of registered models on patches that their cross-validation held out."""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.arrays import I64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.view_mask import CameraMasks, masks_by_mission
from tokt.inference.texture.detector import min_mask_patches
from tokt.models.bundle.bundle import Bundle
from tokt.models.operating_point import MofNRule
from tokt.models.registry.load import is_registered_name, load_model
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import (
    DIVE_ORDER,
    FRAME_KEY,
    PATCH_COLUMNS,
    PATCH_KEY,
    DatasetVersion,
    list_datasets,
)
from tokt.training.datasets.folds import positions_of
from tokt.training.evaluation.old_dives import held_out_units

from .frames import NEITHER, OBSTACLE_FRAME, OCEAN, FrameSeries
from .predictions import HELD_OUT, ComparedModels, ModelPredictions, error_margins

_ASK = "give --mission DIR and --labels CSV of a dive that neither learnt from"


def _registered(reference: str, registry: Registry) -> str:
    """``name/version`` in the registry; also of a bundle file that was exported from it."""
    if is_registered_name(reference):
        return registry.find(reference).label
    bundle = load_model(reference)
    run = bundle.content.provenance.get("mlflow_run_id")
    for version in registry.versions(bundle.name):
        if version.version == bundle.version and version.run_id == run:
            return version.label
    raise ToktError(
        f"{reference} is not of this workspace's registry, which alone knows what its "
        f"cross-validation held out; {_ASK}"
    )


def _datasets(
    recipes: Mapping[str, Mapping[str, Any]], workspace: Path
) -> dict[str, DatasetVersion | None]:
    """The dataset of each model; None where all learnt from the same one and it is gone.

    Raises ToktError where they are different ones and one is gone.
    """
    known = {item.hash: item for item in list_datasets(workspace / "datasets")}
    hashes = {label: str(recipe["provenance"]["dataset_hash"]) for label, recipe in recipes.items()}
    datasets = {label: known.get(value) for label, value in hashes.items()}
    if len({str(recipe["grid"]) for recipe in recipes.values()}) > 1:
        raise ToktError(f"the models' patches are of different grids: {_ASK}")
    for label, dataset in datasets.items():
        if dataset is not None:
            dataset.check()
        elif len(set(hashes.values())) > 1:
            raise ToktError(
                f"dataset {recipes[label]['provenance']['dataset']} of {label} is not in this "
                f"workspace, and the others learnt from another one: train all on one, or {_ASK}"
            )
    return datasets


def _common_patches(
    tables: Mapping[str, pd.DataFrame], datasets: Mapping[str, DatasetVersion | None]
) -> dict[str, pd.DataFrame]:
    """The patches that all models know, with the same label in the same picture, in one order."""
    known = {}
    for label, table in tables.items():
        dataset = datasets[label]
        table = table.assign(position=positions_of(table))
        pictures = table[[*FRAME_KEY, "position"]].drop_duplicates().assign(digest="")
        if dataset is not None:
            pictures = dataset.frames[[*FRAME_KEY, "position", "digest"]]
        known[label] = table.drop(columns="position").merge(pictures, on=FRAME_KEY)
    keys = [*PATCH_KEY, "label", "digest"]
    common = reduce(lambda one, other: one.merge(other), (table[keys] for table in known.values()))
    order = [*DIVE_ORDER, "row", "col"]
    return {
        label: table.merge(common, on=keys).sort_values(order, ignore_index=True)
        for label, table in known.items()
    }


def _held_out_alike(tables: Mapping[str, pd.DataFrame]) -> bool:
    """Whether all held out whole dives, each of them together with the same ones."""
    missions = set.intersection(*({*map(str, table.mission)} for table in tables.values()))
    first, *others = (held_out_units(table, missions) for table in tables.values())
    return first is not None and all(other == first for other in others)


def _folds(kept: Mapping[str, pd.DataFrame], by_dive: bool) -> tuple[I64, dict[str, list[int]]]:
    """A number for each patch, the same for those in the same folds; and each model's fold by it.

    Raises ToktError where the models were cross-validated in other folds, but for whole dives: each
    patch is then judged by models that learnt nothing of its dive.
    """
    together, number = np.unique(
        np.stack([table.fold.to_numpy(np.int64) for table in kept.values()]),
        axis=1,
        return_inverse=True,
    )
    if not by_dive and any(len(np.unique(folds)) < together.shape[1] for folds in together):
        raise ToktError(f"{', '.join(kept)}: not cross-validated in the same folds: {_ASK}")
    return number.ravel(), {
        label: folds.tolist() for label, folds in zip(kept, together, strict=True)
    }


def _frames(
    table: pd.DataFrame, truth: Bools, bundle: Bundle, dataset: DatasetVersion | None
) -> pd.DataFrame:
    """One row a frame, with its kind and its fold."""
    groups = table.assign(clear=~truth).groupby(DIVE_ORDER)
    frames = groups.agg(n=("clear", "size"), clear=("clear", "all"), fold=("fold", "first"))
    masks = masks_by_mission(bundle.content.provenance.get("masks", {}))
    camera_grid = bundle.grid, *bundle.frame_sizes[0]
    in_view = [
        int((~masks.get(name, CameraMasks()).patches(camera, *camera_grid)).sum())
        for name, camera, *_ in frames.index
    ]
    sides = [~frames.clear, frames.n == in_view]
    frames["kind"] = np.select(sides, [OBSTACLE_FRAME, OCEAN], NEITHER)
    frames = frames.reset_index()
    if dataset is not None:
        keys = zip(frames.mission, frames.position, strict=True)
        frames["block"] = [dataset.independent_block(*key) for key in keys]
    return frames


def _predictions(
    bundle: Bundle, recipe: Mapping[str, Any], table: pd.DataFrame, frame: I64, folds: list[int]
) -> ModelPredictions:
    """A model on the patches of a table; `frame` is each one's row in the series.

    `folds` are the model's own, by those of the series.
    """
    columns = [name for name in table if str(name).startswith("value_")]
    values = table[sorted(columns, key=lambda name: int(name.split("_")[1]))].to_numpy(np.float64)
    score = table.obstacle_score.to_numpy(np.float64)
    grid, rules = bundle.grid, recipe["fold_rules"]
    if max(folds) >= len(rules):
        raise ToktError(f"model {bundle.label}: it has {len(rules)} fold rules for more folds")
    cell = (table.row * grid.cols + table.col).to_numpy(np.int64)
    # -inf, which exceeds no margin, where a patch has no score.
    on_grid = np.full((int(frame.max()) + 1, grid.n_patches), -np.inf)
    on_grid[frame, cell] = score
    return ModelPredictions(
        bundle=bundle,
        targets=table.target.to_numpy(np.int64),
        predicted=bundle.model.predicted(values),
        classes=bundle.model.classes,
        error_margin=error_margins(bundle.model, values, table.target.to_numpy(np.int64)),
        score=score,
        on_grid=on_grid,
        white=min_mask_patches(grid, *grid.resized(*bundle.frame_sizes[0])),
        judged=np.ones(len(on_grid), bool),
        fold_rules=[MofNRule.from_json(rules[fold]) for fold in folds],
        split=str(recipe["metrics"]["split"]),
        recipe=recipe,
    )


def _notes(
    total: int,
    kept: int,
    dataset: DatasetVersion | None,
    grid: Grid,
    recipes: Mapping[str, Mapping[str, Any]],
    by_dive: bool,
) -> list[str]:
    if grid.width is None:
        notes = [
            "Every patch is judged by a model that did not learn from it.",
            "UNGROUPED: nothing says which patches come from one photo, so near copies may stand "
            "on both sides. Intervals and p-values take each patch for a block of its own, and are "
            "too sure. There are no frames, and so no statuses.",
        ]
    else:
        notes = [
            "Every patch is judged by a model that learnt nothing of its dive."
            if by_dive
            else "Every patch is judged by a model that did not learn from its block of frames. "
            "The blocks are of the same dives as those learnt from, which flatters every model: "
            "another dive can go much worse.",
            "A frame's status rests on its labelled patches; those marked unsure are not scored. "
            "Each frame is judged at the frame rule chosen without its fold.",
        ]
    chosen = [
        label
        for label, recipe in recipes.items()
        if recipe["provenance"]["preset"] not in ("plain", "thesis")
    ]
    if chosen:
        notes.append(
            f"What {', '.join(chosen)} looks at was itself chosen by cross-validation, perhaps on "
            "these very frames: against a model with plain features it looks somewhat too good."
        )
    if kept < total:
        notes.append(
            f"{total - kept} of {total} patches are left out for all: a model learnt from their "
            "frames, or does not know them."
        )
    if len({recipe["provenance"]["dataset_hash"] for recipe in recipes.values()}) > 1:
        notes.append("The models learnt from different datasets: no pictures, no learning curve.")
    elif dataset is None:
        notes.append("The dataset is not in this workspace: no pictures, no learning curve.")
    return notes


def read_held_out(references: Sequence[str], workspace: Path) -> ComparedModels:
    """Bring registered models together on what none of them learnt from.

    Of models that learnt from different datasets these are the patches that all of them know, if
    each held out whole dives: an adapted model beside the one that it comes from.

    Raises ToktError if a model is not registered, or they are of different folds.
    """
    registry = Registry(workspace)
    labels = [_registered(reference, registry) for reference in references]
    check_different(labels)
    recipes = {label: registry.recipe(registry.find(label)) for label in labels}
    datasets = _datasets(recipes, workspace)
    tables = {label: registry.held_out(label) for label in labels}
    for label, table in tables.items():
        if "value_0" not in table:
            raise ToktError(
                f"model {label} was trained by an older tokt; train it again to compare it"
            )
    total = max(len(table) for table in tables.values())
    # The thesis's models learn from a frame of a dive that they are tested on.
    by_dive = _held_out_alike(tables) and all(
        recipe["provenance"]["preset"] != "thesis" for recipe in recipes.values()
    )
    tables = _common_patches(tables, datasets)
    tested = np.logical_and.reduce([table.fold.to_numpy() >= 0 for table in tables.values()])
    if not tested.any():
        raise ToktError(f"no patch was held out by all of these models; {_ASK}")
    kept = {label: table[tested].reset_index(drop=True) for label, table in tables.items()}
    number, folds = _folds(kept, by_dive)
    first = kept[labels[0]].assign(fold=number)
    bundles = {label: registry.bundle(label) for label in labels}
    truth = np.asarray(bundles[labels[0]].model.obstacle, bool)[first.target.to_numpy()]
    series = FrameSeries.of(_frames(first, truth, bundles[labels[0]], datasets[labels[0]]))
    # The table is sorted as the series is.
    frame = first.groupby(DIVE_ORDER).ngroup().to_numpy(np.int64)
    names = list(dict.fromkeys(str(recipe["provenance"]["dataset"]) for recipe in recipes.values()))
    # Pictures and learning curve are of one dataset.
    dataset = datasets[labels[0]] if len(names) == 1 else None
    return ComparedModels(
        mode=HELD_OUT,
        what=f"dataset {' and '.join(names)}"
        + (" (UNGROUPED)" if bundles[labels[0]].grid.width is None else ""),
        patches=first[[*PATCH_COLUMNS, "position"]],
        truth=truth,
        models=[_predictions(bundles[x], recipes[x], kept[x], frame, folds[x]) for x in labels],
        series=series,
        read_frame=None if dataset is None else _reader(dataset),
        dataset=dataset,
        notes=_notes(total, int(tested.sum()), dataset, bundles[labels[0]].grid, recipes, by_dive),
    )


def check_different(labels: Sequence[str], hashes: Sequence[str] | None = None) -> None:
    """Raise ToktError where one model is named twice, or there is only one.

    With the bundles' `hashes`, two models that share a name and version are told from one.
    """
    for index, label in enumerate(labels):
        if label not in labels[:index]:
            continue
        if hashes is not None and hashes[labels.index(label)] != hashes[index]:
            raise ToktError(
                f"two different models are called {label}; train one under another --name"
            )
        raise ToktError(f"model {label} is given twice")
    if len(labels) < 2:
        raise ToktError("compare needs at least two models")


def _reader(dataset: DatasetVersion) -> Callable[[str, str, int], U8 | None]:
    index = pd.MultiIndex.from_frame(dataset.frames[FRAME_KEY])

    def read(*key: Any) -> U8 | None:
        row = int(index.get_loc(key))
        return dataset.read_frame(row) if dataset.pictured[row] else None

    return read
