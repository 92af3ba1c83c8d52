"""Every kind of input that is tried."""

from __future__ import annotations

from . import bundle_kinds, calibration_kinds, label_kinds, run_kinds, setting_kinds, store_kinds
from .case import Kind

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kinds in (
        bundle_kinds,
        calibration_kinds,
        label_kinds,
        run_kinds,
        setting_kinds,
        store_kinds,
    )
    for kind in kinds.KINDS
}
