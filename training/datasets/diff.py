"""The difference of two dataset versions: settings, missions, frames, labels, sources."""

from typing import Any

import pandas as pd

from .dataset import FRAME_KEY, PATCH_KEY, DatasetVersion


def diff_datasets(before: DatasetVersion, after: DatasetVersion) -> dict[str, Any]:
    """Compare two dataset versions, each checked against its hash.

    A patch is the same where mission, camera, frame, row and column are, whatever its frame shows.

    Returns JSON: before, after (labels), same_content; settings {name: [before, after]} of those
    that changed; frames, patches, unsure_left_out and labels {class: ...} [before, after]; missions
    {added, gone, changes: {mission: counts}}; relabelled [{from, to, patches}], null where the
    grids differ; and sources {gone, added}, missions and annotators in the words of each version's
    first build, which the hash does not cover.

    Raises ToktError if a version is damaged, or was changed on disk.
    """
    both = (before, after)
    for one in both:
        one.check()
    settings = _pairs(_settings(before), _settings(after), None)
    names = [set(one.frames.mission) for one in both]
    labels, sources = ([one.info[key] for one in both] for key in ("labels", "sources"))
    frames = before.frames.merge(after.frames, "outer", on=FRAME_KEY, indicator="side")
    other = {"with_other_pixels": "digest", "regrouped": "group"}
    counts, moved = [_changes(frames, "frames", other)], None
    if before.grid == after.grid:
        patches = before.patches.merge(after.patches, "outer", on=PATCH_KEY, indicator="side")
        counts.append(_changes(patches, "patches", {"relabelled": "label"}))
        changed = patches[(patches.side == "both") & (patches.label_x != patches.label_y)]
        pairs = changed.groupby(["label_x", "label_y"]).size().items()
        moved = [{"from": a, "to": b, "patches": int(n)} for (a, b), n in pairs]
    changes = pd.concat(counts, axis=1).fillna(0).astype(int).T.to_dict()
    found = {name: {key: n for key, n in row.items() if n} for name, row in changes.items()}
    return {
        **{"before": before.label, "after": after.label},
        "same_content": before.hash == after.hash,
        "settings": {name: two for name, two in settings.items() if two[0] != two[1]},
        **{
            key: [one.info[key] for one in both] for key in ("frames", "patches", "unsure_left_out")
        },
        "labels": _pairs(labels[0], labels[1], 0),
        "missions": {
            "added": sorted(names[1] - names[0]),
            "gone": sorted(names[0] - names[1]),
            "changes": {name: row for name, row in found.items() if row},
        },
        "relabelled": moved,
        "sources": {
            "gone": [line for line in sources[0] if line not in sources[1]],
            "added": [line for line in sources[1] if line not in sources[0]],
        },
    }


def _settings(dataset: DatasetVersion) -> dict[str, Any]:
    classes = dataset.taxonomy.to_json()["classes"]
    return {
        **{"task": dataset.task, "grid": str(dataset.grid), "block_frames": dataset.block_frames},
        **{"sites": dataset.sites, "classes": ", ".join(one["name"] for one in classes)},
        **{f"class {one['name']}": one for one in classes},
    }


def _pairs(before: dict[str, Any], after: dict[str, Any], missing: Any) -> dict[str, list[Any]]:
    names = {**before, **after}
    return {name: [before.get(name, missing), after.get(name, missing)] for name in names}


def _changes(merged: pd.DataFrame, what: str, other: dict[str, str]) -> pd.DataFrame:
    """Rows of a merged table that are gone, added or have another value, counted by mission."""
    kinds = {
        f"{what}_gone": merged.side == "left_only",
        f"{what}_added": merged.side == "right_only",
    }
    for name, column in other.items():
        differ = merged[f"{column}_x"] != merged[f"{column}_y"]
        kinds[f"{what}_{name}"] = differ & (merged.side == "both")
    return pd.DataFrame(kinds).groupby(merged.mission).sum()
