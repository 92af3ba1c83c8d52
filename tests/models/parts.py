"""Bundle files taken apart and put together again, with hashes that fit or do not."""

import hashlib
import io
import json
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from tokt.features.common.canonical import json_sha256
from tokt.features.extractors.patch_detail import MEASURES
from tokt.models.bundle.bundle import Golden
from tokt.models.sight import SightLimits

SEES_ALL = (SightLimits(271, 360, 4.0, 1.0, (99.0,) * len(MEASURES), 1.0),)
"""Limits that only a dark, saturated or flat picture is beyond."""

Members = dict[str, bytes]
_NOT_HASHED = ("manifest.json", "signature.json")


def golden_of(frames: Sequence[Any], values: Any, obstacle: Any) -> Golden:
    """Golden frames and what a model made of them."""
    pngs = tuple(cv2.imencode(".png", frame)[1].tobytes() for frame in frames)
    return Golden(pngs, np.array(values), np.array(obstacle))


def unpack(data: bytes) -> Members:
    """The members of a zip."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(members, compression=zipfile.ZIP_STORED) -> bytes:
    """A zip of members; of pairs, a name may be there twice."""
    pairs = members.items() if isinstance(members, Mapping) else members
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a name is there twice
        for name, data in pairs:
            archive.writestr(name, data)
    return buffer.getvalue()


def rehash(members: Members, edit: Mapping[str, Any] | None = None) -> bytes:
    """The members as a bundle whose hashes all fit; entries of `edit` replace the manifest's.

    One that is None there is left out.
    """
    entries = {**json.loads(members["manifest.json"]), **(edit or {})}
    manifest = {name: value for name, value in entries.items() if value is not None}
    del manifest["manifest_sha256"]
    manifest["members"] = {
        name: hashlib.sha256(data).hexdigest()
        for name, data in members.items()
        if name not in _NOT_HASHED
    }
    manifest["manifest_sha256"] = json_sha256(manifest)
    return pack({**members, "manifest.json": json.dumps(manifest).encode()})
