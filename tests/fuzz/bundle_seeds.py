"""Small sound bundles to start from, and bundles put together again after a change."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tokt.features.canonical import json_sha256
from tokt.features.extractor import Extractor, build_extractor, extractor_named
from tokt.features.grid import Grid
from tokt.models.bundle import BundleContent, Golden, bundle_bytes
from tokt.models.distribution import Distribution, bin_counts, quantile_edges
from tokt.models.linear import LinearModel
from tokt.models.operating_point import FrameRule, OperatingPoint

from .zip_changes import entries_of, zip_bytes

_OLDER = Path(__file__).parents[1] / "models"
_PLAIN = {"name": "lbp", "version": 1, "points": 4, "radius": 1, "border": "patch"}
_FLAT = {"window": 3, "by": "frame"}
_LEVELS = {"resize": "area_deep", "gray": "bt601", "smooth": 1, "gain": 2, "levels": 16}
SPECS: tuple[dict[str, Any], ...] = (
    {**_PLAIN, "image": "area_gray"},
    {
        "name": "join",
        "version": 1,
        "parts": [
            {"name": "haralick", "version": 2, "ignore_zeros": True, "scale": "log"}
            | {"image": "area_gray"},
            {"name": "moments", "version": 1, "image": {**_LEVELS, "flatten": _FLAT}},
        ],
    },
    {
        "name": "context",
        "version": 1,
        "statistic": "max",
        "part": {"name": "lines", "version": 1, "samples": [2, 4]}
        | {"image": {**_LEVELS, "flatten": None}},
    },
    {**_PLAIN, "version": 2, "sampling": "nearest", "image": {**_LEVELS, "flatten": _FLAT}},
    {"name": "structure", "version": 1, "image": {**_LEVELS, "flatten": _FLAT}},
)


def content(
    extractor: Extractor,
    grid: Grid,
    frames: list[NDArray[np.uint8]],
    classes: tuple[tuple[str, bool], ...] = (("ocean", False), ("other", True)),
    weights: NDArray[np.float64] | None = None,
) -> BundleContent:
    """What a bundle of random weights holds; of given ones where they are given."""
    rng = np.random.default_rng(5)
    outputs = 1 if len(classes) == 2 else len(classes)
    found = rng.normal(size=(outputs, extractor.dim)) if weights is None else weights
    names, flags = zip(*classes, strict=True)
    model = LinearModel(found, rng.normal(size=outputs), np.zeros(outputs), names, flags)
    if weights is None:
        values = np.array([model.decision_values(extractor.describe(f, grid)) for f in frames])
    else:
        values = np.broadcast_to(model.bias, (len(frames), grid.n_patches, outputs)).copy()
    obstacle = np.array([model.obstacle_patches(of_one) for of_one in values])
    return BundleContent(
        name="fuzz",
        version="1",
        extractor_spec=extractor.spec,
        grid=grid,
        model=model,
        provenance={"mlflow_run_id": "0" * 32, "dataset": "drawn@1", "code_version": "0.1.0"},
        metrics={"patch": {"f1": 0.5, "recall": None}, "folds": [{"f1": 0.25}]},
        golden=Golden(
            tuple(cv2.imencode(".png", frame)[1].tobytes() for frame in frames), values, obstacle
        ),
        trained_on=rng.integers(0, 2**63, 3).astype(np.uint64),
        card="# fuzz/1\n\nbølge\n",
        operating_point=OperatingPoint(FrameRule(0.25, 2, 1, 3, 0.5), {"target_rate": 1e-4}),
        distribution=_distribution(extractor, grid, frames) if weights is None else None,
    )


def _distribution(
    extractor: Extractor, grid: Grid, frames: list[NDArray[np.uint8]]
) -> Distribution:
    features = np.concatenate([extractor.describe(frame, grid) for frame in frames])
    edges = np.stack([quantile_edges(column) for column in features.T])
    typical = np.full(extractor.dim, 0.1)
    return Distribution(edges, bin_counts(features, edges), typical, 3.0, 20, 90, 9)


def textured(height: int, width: int, seed: int = 1) -> NDArray[np.uint8]:
    """A frame of noise."""
    return np.random.default_rng(seed).integers(0, 250, (height, width), np.uint8)


@cache
def small_bundles() -> tuple[bytes, ...]:
    """One of each kind of extractor, and one of each older format."""
    more = (("ocean", False), ("other", True), ("sand", True))
    made = [
        bundle_bytes(
            content(
                build_extractor(whole_spec(spec)),
                Grid(2, 2, 12),
                [textured(8, 12)],
                more if number % 2 else more[:2],
            )
        )
        for number, spec in enumerate(SPECS)
    ]
    older = [path.read_bytes() for path in sorted(_OLDER.glob("bundle_of_format_*.zip"))]
    return tuple(made + older)


@cache
def real_bundle() -> bytes:
    """One as large as those that are shipped."""
    extractor = extractor_named("haralick+lbp_24_8_frame")
    frames = [cv2.resize(textured(68, 90, seed), (360, 271)) for seed in (1, 2)]
    return bundle_bytes(content(extractor, Grid(), frames))


@cache
def _plain_image() -> Any:
    return extractor_named("lbp").spec["image"]


def whole_spec(spec: dict[str, Any]) -> dict[str, Any]:
    """The spec with the plain image as this version calls it."""
    if "parts" in spec:
        return {**spec, "parts": [whole_spec(part) for part in spec["parts"]]}
    return {**spec, "image": _plain_image()} if spec.get("image") == "area_gray" else spec


@cache
def members_of(data: bytes) -> dict[str, bytes]:
    """A sound bundle's members; not to be changed."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@cache
def _manifest_text(data: bytes) -> bytes:
    return members_of(data)["manifest.json"]


def manifest_of(data: bytes) -> dict[str, Any]:
    """A sound bundle's manifest, to be changed."""
    found: dict[str, Any] = json.loads(_manifest_text(data))
    return found


def put_together(members: Mapping[str, bytes], manifest: bytes | dict[str, Any]) -> bytes:
    """A bundle whose hashes fit, whatever else does not.

    Parameters
    ----------
    members : mapping
        The other members.
    manifest : bytes or dict
        Text that is JSON or not; what of it is an object gets the hashes.
    """
    text = json.dumps(manifest).encode() if isinstance(manifest, dict) else manifest
    return zip_bytes(entries_of({"manifest.json": _with_hashes(text, members), **members}))


def _with_hashes(text: bytes, members: Mapping[str, bytes]) -> bytes:
    try:
        manifest = json.loads(text)
    except (ValueError, RecursionError):
        return text
    if not isinstance(manifest, dict):
        return text
    if isinstance(manifest.get("members"), dict):
        for name, data in members.items():
            if name in manifest["members"]:
                manifest["members"][name] = hashlib.sha256(data).hexdigest()
    manifest.pop("manifest_sha256", None)
    try:
        manifest["manifest_sha256"] = json_sha256(manifest)
        return json.dumps(manifest).encode()
    except (ValueError, RecursionError):
        return text
