"""Findings of ``tokt findings`` as proposals that a person confirms: GeoJSON becomes an audit."""

from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError, check_format
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import LEFT

from .audit_csv import Audit, AuditedPatch
from .text_file import objects, of_kind, read_json, whole

NEWEST = 1
"""The newest format that is read (`tokt.inference.replay.findings_file.FORMAT`)."""
_RULE = "what a run saw and nobody labelled yet, along its track"


def findings_audit(path: Path, mission: str, grid: Grid) -> Audit:
    """The findings of one mission in a GeoJSON file, as an audit of patches without labels.

    The patches of one finding's best frame are a group, which is decided at once.

    Raises ToktError if the file is none of ``tokt findings``, of a newer tokt, of other missions
    only, or of another grid.
    """
    value = of_kind(read_json(path), dict, f"{path}")
    try:
        check_format(value.get("tokt_findings"), NEWEST, f"{path}: the list of findings")
    except ValueError:
        raise ToktError(f"{path} holds no findings of tokt") from None
    patches: list[AuditedPatch] = []
    others: set[str] = set()
    for number, (where, feature) in enumerate(
        objects(value.get("features"), f"{path}: features", "feature"), 1
    ):
        found = of_kind(feature.get("properties"), dict, f"{path}: {where}: properties")
        named = of_kind(found.get("mission"), str, f"{path}: {where}: mission")
        if named != mission:
            others.add(named)
            continue
        if (its := Grid.parse(of_kind(found.get("grid"), str, f"{path}: {where}: grid"))) != grid:
            raise ToktError(f"{path}: the findings are of the grid {its}: label with --grid {its}")
        patches += _patches(found, grid, number, f"{path}: {where}")
    if others and not patches:
        raise ToktError(f"{path}: no finding is of {mission}, but of {', '.join(sorted(others))}")
    return Audit(path.stem, f"Findings of {mission}", grid, _RULE, tuple(patches))


def _patches(found: dict[str, Any], grid: Grid, number: int, where: str) -> list[AuditedPatch]:
    label = of_kind(found.get("label"), str, f"{where}: label")
    best, first, last = (
        whole(found.get(f"{name}_frame"), f"{where}: {name}_frame")
        for name in ("best", "first", "last")
    )
    along = found.get("along_m")
    place = f", {along:.1f} m along the track" if isinstance(along, int | float) else ""
    made = []
    for cell in of_kind(found.get("patches"), list, f"{where}: patches"):
        row, col = divmod(whole(cell, f"{where}: patch"), grid.cols)
        if not grid.contains(row, col):
            raise ToktError(f"{where}: patch {cell} is not in the grid {grid}")
        reason = f"finding {number}: {label}, frames {first} to {last}{place}"
        place_of = (found["mission"], LEFT, best, row, col)
        made.append(AuditedPatch(*place_of, "", label, 0.0, reason, number))
    return made
