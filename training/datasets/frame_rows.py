"""Feature rows in place of pictures: what a dataset holds of frames that must not be given away.

A file of rows holds several frames of a dive. It has the features of each frame's patches, in the
order of the grid, and of some patches of the frame as random changes made it. Each value has 4
bits, two values a byte: a feature ranges over three standard deviations to either side of its mean.
The file is named by the SHA-256 of its bytes.

To change the format: raise FORMAT_VERSION, keep reading the old one, prove it with a test.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64, U8
from tokt.features.common.canonical import json_sha256, printable_json
from tokt.features.common.errors import ToktError, check_format, os_errors_as
from tokt.models.bundle.bundle import arrays_of, npz_bytes, unzip

FORMAT_VERSION = 1
SUFFIX = ".rows"
_LEVELS = 15  # steps of 4 bits
_RANGE = 3.0  # standard deviations to either side; a map before the weights cuts off at 2.5
_ARRAYS = {
    **dict.fromkeys(("about", "digests", "values", "changed"), np.uint8),
    "cells": np.int32,
    **dict.fromkeys(("low", "step"), np.float32),
}


@dataclass(frozen=True)
class FrameRows:
    """What is known of one frame without its picture."""

    digest: str  # of the frame's pixels
    values: F64  # (n_patches, dim): of the frame as it is
    changed: F64  # (n_changed, dim): of some patches of the frame, changed at random
    cells: I64  # (n_changed,): which patch each of these shows


@dataclass(frozen=True)
class Scale:
    """How features become 4 bits: the lowest value and the step of each."""

    low: F64  # (dim,)
    step: F64  # (dim,)

    @classmethod
    def of(cls, features: F64) -> "Scale":
        """Return the scale for a table of features, shape (n, dim); n may be 0."""
        if not len(features):
            return cls(np.zeros(features.shape[1]), np.ones(features.shape[1]))
        spread = features.std(axis=0)
        step = np.where(spread > 0, 2 * _RANGE * spread / _LEVELS, 1.0)
        low = features.mean(axis=0) - 0.5 * _LEVELS * step
        return cls(*(each.astype(np.float32).astype(np.float64) for each in (low, step)))

    def packed(self, features: F64) -> U8:
        """Return features, shape (..., dim), as 4 bits each, shape (..., (dim + 1) // 2)."""
        levels = np.rint((features - self.low) / self.step).clip(0, _LEVELS).astype(np.uint8)
        if levels.shape[-1] % 2:
            levels = np.concatenate([levels, np.zeros_like(levels[..., :1])], axis=-1)
        return np.asarray(levels[..., ::2] << 4 | levels[..., 1::2], np.uint8)

    def unpacked(self, packed: U8) -> F64:
        """Return what `packed` was made of, to half a step."""
        levels = np.stack([packed >> 4, packed & 15], axis=-1).reshape(*packed.shape[:-1], -1)
        return np.asarray(self.low + self.step * levels[..., : len(self.low)], np.float64)


def rows_file(frames: Sequence[FrameRows], spec: dict[str, Any], changes: str) -> bytes:
    """Return a file of rows of some frames of one dive, one at the least.

    Parameters
    ----------
    frames : sequence of FrameRows
        All with the same number of patches.
    spec : dict
        The extractor's spec.
    changes : str
        The name of the random changes, such as ``random_9``.
    """
    # Each with a scale of its own: what is changed is spread far wider.
    values, changed = np.stack([x.values for x in frames]), [x.changed for x in frames]
    tables = {"values": values.reshape(-1, values.shape[-1]), "changed": np.concatenate(changed)}
    scales = {name: Scale.of(table) for name, table in tables.items()}
    packed = {name: scales[name].packed(table) for name, table in tables.items()}
    about = {"format_version": FORMAT_VERSION, "spec": json_sha256(spec), "changes": changes}
    patches = len(frames[0].values)
    return npz_bytes(
        about=np.frombuffer(json.dumps(about, sort_keys=True).encode(), np.uint8),
        digests=np.stack([np.frombuffer(bytes.fromhex(one.digest), np.uint8) for one in frames]),
        low=np.stack([scale.low for scale in scales.values()]).astype(np.float32),
        step=np.stack([scale.step for scale in scales.values()]).astype(np.float32),
        values=packed["values"].reshape(*values.shape[:2], -1),
        changed=packed["changed"],
        cells=np.concatenate(
            [place * patches + one.cells for place, one in enumerate(frames)]
        ).astype(np.int32),
    )


def file_name(data: bytes) -> str:
    """Return the name of a file of rows."""
    return hashlib.sha256(data).hexdigest() + SUFFIX


def read_frame_rows(
    path: Path, digest: str, spec: dict[str, Any], changes: str | None = None
) -> FrameRows:
    """Read the rows of one frame.

    Parameters
    ----------
    path : Path
        The file of rows.
    digest : str
        The frame's pixel hash.
    spec : dict
        The spec of the extractor whose features are wanted.
    changes : str, optional
        The name of the random changes that are wanted.

    Raises
    ------
    ToktError
        If the file is damaged or not the one that the dataset was built from, has no such frame,
        or holds other features or changes than those that are wanted.
    """
    with os_errors_as(f"dataset frames {path}"):
        data = path.read_bytes()
    if file_name(data) != path.name:
        raise ToktError(f"dataset frames {path} have changed since the dataset was built")
    arrays = arrays_of(unzip(data, str(path)), _ARRAYS, str(path))
    try:
        about = printable_json(arrays["about"].tobytes())
        check_format(about["format_version"], FORMAT_VERSION, f"dataset frames {path}")
        fits = about["spec"] == json_sha256(spec) and changes in (None, about["changes"])
        digests = [bytes(one).hex() for one in arrays["digests"]]
        place = digests.index(digest)
        scales = map(Scale, *(arrays[name].astype(np.float64) for name in ("low", "step")))
        patches = arrays["values"].shape[1]
        mine = arrays["cells"] // patches == place
    except (ValueError, KeyError, TypeError, IndexError):
        raise ToktError(f"dataset frames {path} are damaged") from None
    if not fits:
        raise ToktError(
            f"dataset frames {path} hold features of another extractor, and no pictures: train "
            "with the extractor and the changes that they were made with"
        )
    kept = arrays["values"][place], arrays["changed"][mine]
    values, changed = (scale.unpacked(packed) for scale, packed in zip(scales, kept, strict=True))
    cells = arrays["cells"][mine].astype(np.int64) % patches
    return FrameRows(digest, values, changed, cells)
