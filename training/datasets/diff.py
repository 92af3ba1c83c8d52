"""What changed between two dataset versions: settings, missions, frames, labels, sources."""

from typing import Any

import numpy as np
import pandas as pd

from .dataset import DatasetVersion

_FRAME = ["mission", "camera", "frame"]
_SETTINGS = ("task", "taxonomy", "block_frames", "sites")


def diff_datasets(before: DatasetVersion, after: DatasetVersion) -> dict[str, Any]:
    """Compare two dataset versions, each checked against its hash.

    A patch is the same one where mission, camera, frame, row and column are; what its frame shows
    may have changed all the same, which `frames_with_other_pixels` counts.

    Returns
    -------
    dict
        JSON: before, after (labels), same_content, settings {name: [before, after]} of those that
        changed, frames, patches and unsure_left_out [before, after], labels {class: [before,
        after]}, missions {added, gone, changed, each {mission: counts}}, relabelled [{from, to,
        patches}] (null where the grids differ: their patches are not the same), and sources
        {gone, added}: annotators and missions in the words of each version's first build, which
        the hash does not cover.

    Raises
    ------
    ToktError
        If a version is damaged, or was changed on disk.
    """
    both = (before, after)
    for one in both:
        one.check()
    settings = {key: [one.info.get(key) for one in both] for key in _SETTINGS}
    settings["grid"] = [str(one.grid) for one in both]
    frames = before.frames.merge(after.frames, "outer", on=_FRAME, indicator="side")
    other = {
        "frames_with_other_pixels": frames.digest_x != frames.digest_y,
        "frames_regrouped": frames.group_x != frames.group_y,
    }
    counts = [_by_mission(frames, "frames", other)]
    moved = None
    if before.grid == after.grid:
        place = [*_FRAME, "row", "col"]
        patches = before.patches.merge(after.patches, "outer", on=place, indicator="side")
        other = {"patches_relabelled": patches.label_x != patches.label_y}
        counts.append(_by_mission(patches, "patches", other))
        changed = patches[(patches.side == "both") & other["patches_relabelled"]]
        pairs = changed.groupby(["label_x", "label_y"]).size().sort_values(ascending=False)
        moved = [{"from": a, "to": b, "patches": int(n)} for (a, b), n in pairs.items()]
    names = [set(one.frames.mission) for one in both]
    changes = pd.concat(counts, axis=1).fillna(0).astype(int)
    rows = {name: {k: n for k, n in row.items() if n} for name, row in changes.T.to_dict().items()}
    labels = [one.info["labels"] for one in both]
    sources = [one.info["sources"] for one in both]
    return {
        "before": before.label,
        "after": after.label,
        "same_content": before.hash == after.hash,
        "settings": {key: pair for key, pair in settings.items() if pair[0] != pair[1]},
        **{
            key: [one.info[key] for one in both] for key in ("frames", "patches", "unsure_left_out")
        },
        "labels": {
            name: [of.get(name, 0) for of in labels] for name in sorted({*labels[0], *labels[1]})
        },
        "missions": {
            "added": _content(after, names[1] - names[0]),
            "gone": _content(before, names[0] - names[1]),
            "changed": {name: rows[name] for name in sorted(names[0] & names[1]) if rows[name]},
        },
        "relabelled": moved,
        "sources": {
            "gone": [line for line in sources[0] if line not in sources[1]],
            "added": [line for line in sources[1] if line not in sources[0]],
        },
    }


def _by_mission(merged: pd.DataFrame, what: str, other: dict[str, pd.Series]) -> pd.DataFrame:
    """Rows of a merged table that are gone, added or otherwise changed, counted by mission."""
    there = merged.side == "both"
    kinds = {
        f"{what}_gone": merged.side == "left_only",
        f"{what}_added": merged.side == "right_only",
        **{name: there & changed for name, changed in other.items()},
    }
    return (
        pd.DataFrame({name: np.asarray(kind) for name, kind in kinds.items()})
        .groupby(merged.mission)
        .sum()
    )


def _content(dataset: DatasetVersion, missions: set[str]) -> dict[str, dict[str, int]]:
    return {
        name: {
            "frames": int((dataset.frames.mission == name).sum()),
            "patches": int((dataset.patches.mission == name).sum()),
        }
        for name in sorted(missions)
    }
