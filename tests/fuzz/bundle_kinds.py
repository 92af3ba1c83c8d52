"""Kinds of changed bundles: from the file's bytes inwards, each with the outer hashes right."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from tokt.features.errors import ToktError
from tokt.features.extractor import build_extractor
from tokt.features.grid import Grid
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Report
from tokt.inference.udp import decode, encode_v2
from tokt.inference.verdict import unknown_verdict
from tokt.models.bundle import Bundle, bundle_bytes, bundle_from_bytes
from tokt.models.distribution import drift_words
from tokt.models.signature import MEMBER as SIGNATURE
from tokt.models.signature import Signature

from .bundle_seeds import (
    SPECS,
    content,
    manifest_of,
    members_of,
    put_together,
    real_bundle,
    small_bundles,
    textured,
    whole_spec,
)
from .bytes_changes import changed_bytes
from .case import Files, Kind
from .json_changes import TEXTS, changed_json, changed_text, odd_value, text_of
from .npz_changes import changed_npz, npy_bytes
from .png_changes import changed_png, some_picture
from .zip_changes import changed_zip, entries_of, zip_bytes

FILE = "bundle.tokt"
_LARGEST_DATAGRAM = 1472
"""Bytes that fit an Ethernet frame behind the headers of IPv4 and UDP."""


def read_bundle_file(files: Files, folder: Path) -> object:
    """Read a bundle and do with it what the runtime does with any."""
    bundle = bundle_from_bytes(files[FILE], FILE)
    check_usable(bundle)
    return bundle


def check_usable(bundle: Bundle) -> None:
    """What a bundle that was accepted must be fit for; AssertionError where it is not."""
    verdict = replace(unknown_verdict(Fault(Reason.NO_FRAME, "none")), model=bundle.label)
    data = encode_v2(Report(1, 1, 0.0, 1.0, verdict))
    assert decode(data)["model"] == bundle.label
    assert len(data) <= _LARGEST_DATAGRAM, f"a datagram of {len(data)} bytes"
    told = {"label": bundle.label, "provenance": bundle.content.provenance}
    json.dumps(told, ensure_ascii=False, allow_nan=False).encode("utf-8")  # `tokt store --json`
    assert bundle.label.isprintable()
    assert isinstance(bundle.deployment_fault, str)
    assert bundle.operating_point.rule.words()
    assert bundle.frame_sizes
    known = bundle.distribution
    if known is not None:
        assert drift_words(json.loads(json.dumps(known.summary(), allow_nan=False)))
        features = np.zeros((bundle.grid.n_patches, bundle.model.dim))
        assert np.isfinite(known.distances(known.bin_counts(features))).all()


# --- from the outside in ---


def _bytes(rng: Random) -> Files:
    seeds = small_bundles()
    return {FILE: changed_bytes(rng.choice(seeds), rng, seeds)}


def _zip(rng: Random) -> Files:
    return {FILE: changed_zip(members_of(rng.choice(small_bundles())), rng)}


def _other_members(data: bytes) -> dict[str, bytes]:
    return {name: raw for name, raw in members_of(data).items() if name != "manifest.json"}


def _manifest(rng: Random) -> Files:
    """The manifest changed anywhere."""
    data = rng.choice(small_bundles())
    manifest = manifest_of(data)
    text = changed_text(manifest, rng, [manifest_of(rng.choice(small_bundles()))])
    return {FILE: put_together(_other_members(data), text)}


_FIELDS = ("extractor", "grid", "classes", "operating_point", "name", "version", "metrics")


def _fields(rng: Random) -> Files:
    """One part of the manifest changed, so that it gets past the first checks."""
    data = rng.choice(small_bundles())
    manifest = manifest_of(data)
    for field in rng.sample(
        sorted({*_FIELDS, "provenance"} & set(manifest)), rng.choice((1, 1, 2))
    ):
        value = manifest[field]
        manifest[field] = changed_json(value, rng) if rng.random() < 0.8 else odd_value(rng)
    return {FILE: put_together(_other_members(data), text_of(manifest))}


def _arrays(rng: Random) -> Files:
    data = rng.choice(small_bundles())
    members = _other_members(data)
    name = rng.choice(sorted(name for name in members if name.endswith(".npz")))
    members[name] = changed_npz(members[name], rng)
    if rng.random() < 0.1:
        members["card.md"] = changed_bytes(members["card.md"], rng, [b"# card"])
    return {FILE: put_together(members, manifest_of(data))}


def _golden(rng: Random) -> Files:
    """Other golden pictures, with the sizes and sums that belong to them."""
    data = rng.choice(small_bundles())
    members = _other_members(data)
    arrays = np.load(io.BytesIO(members["golden.npz"]))
    pictures = [changed_png(arrays["frames"].tobytes(), rng) for _ in arrays["sizes"]]
    frames = rng.choice((*[1] * 20, 2, 30, 400))
    found = {
        "frames": np.frombuffer(b"".join(pictures * frames), np.uint8),
        "sizes": np.array([len(picture) for picture in pictures * frames], np.int64),
        "decision_values": np.concatenate([arrays["decision_values"]] * frames),
        "obstacle": np.concatenate([arrays["obstacle"]] * frames),
    }
    members["golden.npz"] = zip_bytes(
        entries_of({f"{name}.npy": npy_bytes(array) for name, array in found.items()})
    )
    return {FILE: put_together(members, manifest_of(data))}


# --- models that are sound as far as this machine's own arithmetic goes ---

_WHOLE = (0, 1, 2, 3, 4, 8, 16, 24, 31, 32, 33, 63, 64, 65, 121, 255, 257, 1000, 10**6, 2**31, -1)


def _some_spec(rng: Random, depth: int = 1) -> Any:
    """An extractor's spec whose numbers are anything."""
    spec = json.loads(json.dumps(whole_spec(rng.choice(SPECS))))
    if depth and rng.random() < 0.3:
        parts = [_some_spec(rng, 0) for _ in range(rng.choice((2, 3, 8, 100)))]
        spec = {"name": "join", "version": 1, "parts": parts}
    return _with_numbers(spec, rng)


def _with_numbers(value: Any, rng: Random) -> Any:
    if isinstance(value, dict):
        return {key: _with_numbers(part, rng) for key, part in value.items()}
    if isinstance(value, list):
        return [_with_numbers(part, rng) for part in value]
    if type(value) in (int, float) and rng.random() < 0.1:
        return rng.choice((*_WHOLE, 0.5, 1e-300, 1024.0))
    if isinstance(value, str) and rng.random() < 0.05:
        return rng.choice(("ratio", "difference", "frame", "bilinear", "range", "mean", "min"))
    return value


def _some_sizes(rng: Random) -> tuple[int, int, int | None]:
    rows, cols = rng.choice(((1, 1), (2, 2), (1, 9), (9, 1), (3, 4), (40, 40), (10, 10)))
    return rows, cols, rng.choice((None, 36, 130, 130, 360, 360, 1360, 5000))


def _spec(rng: Random) -> Files:
    """A model of no weight: it gives its bias for any features, so only these can fail."""
    try:
        extractor, grid = build_extractor(_some_spec(rng)), Grid(*_some_sizes(rng))
        frame = textured(*rng.choice(((8, 12), (9, 400), (400, 9), (33, 48), (271, 360))))
        more = (("ocean", False), ("other", True), ("sand", True))[: rng.choice((2, 3))]
        weights = np.zeros((1 if len(more) == 2 else 3, extractor.dim))
        made = content(extractor, grid, [frame], more, weights)
    except ToktError:  # a spec or a grid that cannot be built here: as a file it is tried below
        return {FILE: _raw_spec(rng)}
    data = bundle_bytes(made)
    if rng.random() < 0.7:
        return {FILE: data}
    members = _other_members(data)
    arrays = np.load(io.BytesIO(members["golden.npz"]))
    picture = some_picture(rng)
    found = {
        "frames": np.frombuffer(picture, np.uint8),
        "sizes": np.array([len(picture)]),
        "decision_values": arrays["decision_values"],
        "obstacle": arrays["obstacle"],
    }
    members["golden.npz"] = zip_bytes(
        entries_of({f"{name}.npy": npy_bytes(array) for name, array in found.items()})
    )
    return {FILE: put_together(members, manifest_of(data))}


def _raw_spec(rng: Random) -> bytes:
    data = rng.choice(small_bundles())
    manifest = manifest_of(data)
    manifest["extractor"] = changed_json(_some_spec(rng), rng)
    manifest["grid"] = changed_json(
        dict(zip(("rows", "cols", "width"), _some_sizes(rng), strict=True)), rng
    )
    return put_together(_other_members(data), text_of(manifest))


def _words(rng: Random) -> Files:
    """Texts that nothing computes with, which are accepted unless somebody looks at them."""
    data = rng.choice(small_bundles())
    manifest = manifest_of(data)
    which = rng.choice(("name", "version", "provenance", "metrics", "class", "chosen"))
    text = rng.choice((*TEXTS, "x" * rng.randrange(1, 3000), "ø" * rng.randrange(1, 3000)))
    if which in ("name", "version"):
        manifest[which] = text
    elif which == "class":
        manifest["classes"][rng.randrange(2)]["name"] = text
    elif which == "chosen" and "operating_point" in manifest:
        manifest["operating_point"]["chosen"] = {text: rng.choice((text, 1, odd_value(rng)))}
    elif which in manifest:
        manifest[which] = {text: text, "dataset": text, "patch": {"f1": text}}
    return {FILE: put_together(_other_members(data), text_of(manifest))}


def _real(rng: Random) -> Files:
    """Any of the above on a bundle of real size."""
    data = real_bundle()
    kind = rng.randrange(5)
    if kind == 0:
        return {FILE: changed_bytes(data, rng, [small_bundles()[0], data])}
    if kind == 1:
        return {FILE: changed_zip(members_of(data), rng)}
    members, manifest = _other_members(data), manifest_of(data)
    if kind == 2:
        return {FILE: put_together(members, changed_text(manifest, rng))}
    if kind == 3:
        name = rng.choice(sorted(name for name in members if name.endswith(".npz")))
        members[name] = changed_npz(members[name], rng)
    else:
        field = rng.choice(_FIELDS)
        manifest[field] = changed_json(manifest[field], rng)
    return {FILE: put_together(members, text_of(manifest))}


def _signature(rng: Random) -> Files:
    """The one member that no hash covers."""
    data = rng.choice(small_bundles())
    value = json.loads(Signature("0" * 32, bytes(64)).to_bytes())
    text = rng.choice((changed_text(value, rng), changed_bytes(text_of(value), rng, [data])))
    return {FILE: zip_bytes(entries_of({**members_of(data), SIGNATURE: text}))}


KINDS = [
    Kind("bundle.bytes", "bundles", 20, _bytes, read_bundle_file),
    Kind("bundle.zip", "bundles", 15, _zip, read_bundle_file),
    Kind("bundle.manifest", "bundles", 20, _manifest, read_bundle_file),
    Kind("bundle.fields", "bundles", 20, _fields, read_bundle_file),
    Kind("bundle.words", "bundles", 5, _words, read_bundle_file),
    Kind("bundle.arrays", "bundles", 15, _arrays, read_bundle_file),
    Kind("bundle.golden", "bundles", 7, _golden, read_bundle_file),
    Kind("bundle.signature", "bundles", 3, _signature, read_bundle_file),
    Kind("bundle.spec", "bundles", 3, _spec, read_bundle_file),
    Kind("bundle.real size", "bundles", 1, _real, read_bundle_file, most=1000),
]
