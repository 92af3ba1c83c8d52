"""Kinds of changed bundles: from the file's bytes inwards, each with the outer hashes right."""

import hashlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import cycle
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np

from tests.models.parts import SEES_ALL, golden_of, unpack
from tokt.features.common.arrays import U8
from tokt.features.common.canonical import json_sha256
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import Extractor, build_extractor, extractor_named
from tokt.features.frames.grid import Grid
from tokt.inference.outputs.udp import decode, encode_v2
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Report
from tokt.inference.verdict import unknown_verdict
from tokt.models.bundle.bundle import Bundle, BundleContent, bundle_bytes, bundle_from_bytes
from tokt.models.bundle.signature import MEMBER as SIGNATURE
from tokt.models.bundle.signature import Signature
from tokt.models.distribution import (
    Distribution,
    bin_counts,
    drift_words,
    ks_distances,
    quantile_edges,
)
from tokt.models.linear import LinearModel
from tokt.models.nystroem import NystroemMap
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.water import WaterPrior

from .case import Files, Kind, change_one
from .changes import (
    TEXTS,
    chance,
    changed_bytes,
    changed_file,
    changed_json,
    changed_text,
    odd_value,
    text_of,
)
from .containers import changed_npz, changed_png, changed_zip, npz_bytes, some_picture, zip_bytes

FILE = "bundle.tokt"
Others = Sequence[bytes]
_MAX_DATAGRAM = 1472  # bytes that fit an Ethernet frame behind the headers of IPv4 and UDP


def _read_bundle(folder: Path) -> Bundle:
    """Read a bundle and do with it what the runtime does with any."""
    bundle = bundle_from_bytes((folder / FILE).read_bytes(), FILE)
    check_usable(bundle)
    return bundle


def check_usable(bundle: Bundle) -> None:
    """What a bundle that was accepted must be fit for; AssertionError where it is not."""
    verdict = replace(unknown_verdict(Fault(Reason.NO_FRAME, "none")), model=bundle.label)
    data = encode_v2(Report(1, 1, 0.0, 1.0, verdict))
    assert decode(data)["model"] == bundle.label
    assert len(data) <= _MAX_DATAGRAM, f"a datagram of {len(data)} bytes"
    told = {"label": bundle.label, "provenance": bundle.content.provenance}
    json.dumps(told, ensure_ascii=False, allow_nan=False).encode("utf-8")  # `tokt store --json`
    assert bundle.label.isprintable()
    assert isinstance(bundle.deployment_fault, str)
    assert bundle.operating_point.rule.words()
    assert bundle.frame_sizes
    if (water := bundle.operating_point.water) is not None:
        for values in bundle.golden.decision_values:
            moved = water.boundary(bundle.model.obstacle_score(values))
            assert abs(moved) <= water.limit + 0.005
    known = bundle.distribution
    if known is not None:
        assert drift_words(json.loads(json.dumps(known.summary(), allow_nan=False)))
        features = np.zeros((bundle.grid.n_patches, bundle.model.dim))
        counts = bin_counts(features, known.edges)
        assert np.isfinite(ks_distances(counts, known.counts)).all()


_OLDER = Path(__file__).parents[1] / "models" / "bundle"
_LBP = {"name": "lbp", "version": 1, "points": 4, "radius": 1, "border": "patch"}
_LEVELS = {"resize": "area_deep", "gray": "bt601", "smooth": 1, "gain": 2, "levels": 16}
_DEEP = {"image": {**_LEVELS, "flatten": {"window": 3, "by": "frame"}}}
_TWO = (("ocean", False), ("other", True))
_THREE = (*_TWO, ("sand", True))


@cache
def specs() -> tuple[dict[str, Any], ...]:
    plain = {"image": extractor_named("lbp").spec["image"]}
    haralick = _spec_of("haralick", version=2, ignore_zeros=True, scale="log", **plain)
    lines = _spec_of("lines", samples=[2, 4], image={**_LEVELS, "flatten": None})
    gradients, colour = _spec_of("gradients", smooth=[1, 3]), _spec_of("colour", cells=3)
    relative = _spec_of("relative", quietest=0.5, parts=[gradients, colour])
    return (
        {**_LBP, **plain},
        _spec_of("join", parts=[haralick, _spec_of("moments", **_DEEP)]),
        _spec_of("context", statistic="max", part=lines),
        {**_LBP, "version": 2, "sampling": "nearest", **_DEEP},
        _spec_of("structure", **_DEEP),
        _spec_of("half", part=_spec_of("join", parts=[gradients, lines])),
        _spec_of("join", parts=[relative, _spec_of("place")]),
    )


def _spec_of(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "version": 1, **more}


def textured(height: int, width: int, seed: int = 1) -> U8:
    return np.random.default_rng(seed).integers(0, 250, (height, width), np.uint8)


def _content(extractor: Extractor, grid: Grid, frames: list[U8], classes=_TWO, weightless=False):
    """What a bundle of random weights holds; weightless, it gives its bias for any features."""
    rng = np.random.default_rng(5)
    outputs, dim = 1 if len(classes) == 2 else len(classes), extractor.dim
    weights = rng.normal(size=(outputs, dim)) * (not weightless)
    names, flags = zip(*classes, strict=True)
    bias, mapped, moves = rng.normal(size=outputs), None, {}
    if extractor.needs_colour:
        mapped = NystroemMap(np.ones(dim), np.zeros(dim), 1.5, rng.uniform(-1, 1, (3, dim)), 0.1)
        weights = rng.normal(size=(outputs, 3))
        gray = WaterPrior(-0.5, 0.5, 0.5, 0.5, 0.25)
        moves = {"water": WaterPrior(-1.0, 1.0, 0.5, 0.5, 0.25, gray=gray), "unlike": 2.5}
    model = LinearModel(weights, bias, np.zeros(outputs), names, flags, mapped)
    distribution = None
    if weightless:
        values = np.broadcast_to(model.bias, (len(frames), grid.n_patches, outputs)).copy()
    else:
        features = [extractor.describe(frame, grid) for frame in frames]
        values = np.array([model.decision_values(rows) for rows in features])
        every = np.concatenate(features)
        edges = np.stack([quantile_edges(column) for column in every.T])
        counts = bin_counts(every, edges)
        distribution = Distribution(edges, counts, np.full(dim, 0.1), 3.0, 20, 90, 9)
    return BundleContent(
        *("fuzz", "1", extractor.spec, grid, model),
        provenance={"mlflow_run_id": "0" * 32, "dataset": "drawn@1", "code_version": "0.1.0"},
        metrics={"patch": {"f1": 0.5, "recall": None}, "folds": [{"f1": 0.25}]},
        golden=golden_of(frames, values, [model.obstacle_patches(of_one) for of_one in values]),
        trained_on=rng.integers(0, 2**63, 3).astype(np.uint64),
        card="# fuzz/1\n\nbølge\n",
        operating_point=OperatingPoint(
            MofNRule(0.25, 2, 1, 3, 0.5), {"target_rate": 1e-4}, **moves
        ),
        distribution=distribution,
        sight=SEES_ALL,
    )


@cache
def small_bundles() -> list[Files]:
    """One of each kind of extractor, the last with a map, and one of each older format."""
    grid, gray = Grid(2, 2, 16), textured(12, 16)
    colour = cv2.merge([textured(12, 16, seed) for seed in (1, 2, 3)])
    made = []
    kinds = cycle((_TWO, _THREE))
    for extractor, classes in zip(map(build_extractor, specs()), kinds, strict=False):
        frame = colour if extractor.needs_colour else gray
        made.append(bundle_bytes(_content(extractor, grid, [frame], classes)))
    older = [path.read_bytes() for path in sorted(_OLDER.glob("bundle_of_format_*.zip"))]
    return [{FILE: data} for data in made + older]


@cache
def _real_bundles() -> list[Files]:
    """One as large as those that are shipped."""
    extractor = extractor_named("haralick+lbp_24_8_frame")
    frames = [cv2.resize(textured(68, 90, seed), (360, 271)) for seed in (1, 2)]
    return [{FILE: bundle_bytes(_content(extractor, Grid(), frames))}]


_members_of = cache(unpack)


def _taken_apart(files: Files) -> tuple[dict[str, bytes], dict[str, Any]]:
    """A sound bundle's other members and its manifest, both to be changed."""
    members = dict(_members_of(files[FILE]))
    return members, json.loads(members.pop("manifest.json"))


def _put_together(members: Mapping[str, bytes], manifest: bytes | dict[str, Any]) -> Files:
    """A bundle whose hashes fit, whatever else does not; text that is no object gets none."""
    text = json.dumps(manifest).encode() if isinstance(manifest, dict) else manifest
    return {FILE: zip_bytes({"manifest.json": _with_hashes(text, members), **members})}


def _with_hashes(text: bytes, members: Mapping[str, bytes]) -> bytes:
    try:
        manifest = json.loads(text)
        if not isinstance(manifest, dict):
            return text
        if isinstance(manifest.get("members"), dict):
            for name in manifest["members"].keys() & members:
                manifest["members"][name] = hashlib.sha256(members[name]).hexdigest()
        manifest.pop("manifest_sha256", None)
        manifest["manifest_sha256"] = json_sha256(manifest)
        return json.dumps(manifest).encode()
    except (ValueError, RecursionError):
        return text


def _zip(files: Files, rng: Random, others: Others) -> Files:
    return {FILE: changed_zip(_members_of(files[FILE]), rng)}


def _manifest(files: Files, rng: Random, others: Others) -> Files:
    members, manifest = _taken_apart(files)
    other = _taken_apart({FILE: rng.choice(others)})[1]
    return _put_together(members, changed_text(manifest, rng, [other]))


_FIELDS = ("extractor", "grid", "classes", "operating_point", "name", "version", "metrics")


def _fields(files: Files, rng: Random, others: Others) -> Files:
    """One part of the manifest changed, so that it gets past the first checks."""
    members, manifest = _taken_apart(files)
    known = sorted({*_FIELDS, "provenance"} & set(manifest))
    for field in rng.sample(known, rng.choice((1, 1, 2))):
        odd = chance(rng, 20)
        manifest[field] = odd_value(rng) if odd else changed_json(manifest[field], rng)
    return _put_together(members, text_of(manifest))


def _words(files: Files, rng: Random, others: Others) -> Files:
    """Texts that nothing computes with, which are accepted unless somebody looks at them."""
    members, manifest = _taken_apart(files)
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
    return _put_together(members, text_of(manifest))


def _arrays(files: Files, rng: Random, others: Others) -> Files:
    members, manifest = _taken_apart(files)
    name = rng.choice(sorted(name for name in members if name.endswith(".npz")))
    members[name] = changed_npz(members[name], rng)
    if chance(rng, 10):
        members["card.md"] = changed_bytes(members["card.md"], rng, [b"# card"])
    return _put_together(members, manifest)


def _with_pictures(files: Files, other: Callable[[bytes], bytes], times: int = 1) -> Files:
    """A bundle with other golden pictures, with the sizes and sums that belong to them."""
    members, manifest = _taken_apart(files)
    with np.load(io.BytesIO(members["golden.npz"])) as golden:
        arrays = {name: np.concatenate([golden[name]] * times) for name in golden}
        parts = np.split(golden["frames"], np.cumsum(golden["sizes"])[:-1])
    pictures = [other(part.tobytes()) for part in parts] * times
    arrays["frames"] = np.frombuffer(b"".join(pictures), np.uint8)
    arrays["sizes"] = np.array([len(picture) for picture in pictures], np.int64)
    members["golden.npz"] = npz_bytes(arrays)
    return _put_together(members, manifest)


def _golden(files: Files, rng: Random, others: Others) -> Files:
    times = rng.choice((*[1] * 20, 2, 30, 400))
    return _with_pictures(files, lambda picture: changed_png(picture, rng), times)


def _signature(files: Files, rng: Random, others: Others) -> Files:
    text = changed_file(SIGNATURE, Signature("0" * 32, bytes(64)).to_bytes(), rng, others)
    return {FILE: zip_bytes({**_members_of(files[FILE]), SIGNATURE: text})}


_WHOLE = (0, 1, 2, 3, 4, 8, 16, 24, 31, 32, 33, 63, 64, 65, 121, 255, 257, 1000, 10**6, 2**31, -1)
_PARTS = ("ratio", "difference", "frame", "bilinear", "range", "mean", "min")
_GRIDS = ((1, 1), (2, 2), (1, 9), (9, 1), (3, 4), (40, 40), (10, 10))
_WIDTHS = (None, 36, 130, 130, 360, 360, 1360, 5000)
_FRAMES = ((8, 12), (9, 400), (400, 9), (33, 48), (271, 360))


def _some_spec(rng: Random) -> Any:
    """An extractor's spec whose numbers are anything."""
    spec: Any = rng.choice(specs())
    if chance(rng, 30):
        parts = [_with_numbers(rng.choice(specs()), rng) for _ in range(rng.choice((2, 3, 8)))]
        spec = _spec_of("join", parts=parts * rng.choice((1, 1, 12)))
    return _with_numbers(spec, rng)


def _with_numbers(value: Any, rng: Random) -> Any:
    if isinstance(value, dict):
        return {key: _with_numbers(part, rng) for key, part in value.items()}
    if isinstance(value, list):
        return [_with_numbers(part, rng) for part in value]
    if type(value) in (int, float) and chance(rng, 10):
        return rng.choice((*_WHOLE, 0.5, 1e-300, 1024.0))
    return rng.choice(_PARTS) if isinstance(value, str) and chance(rng, 5) else value


def _spec(files: Files, rng: Random, others: Others) -> Files:
    """A model of no weight, so that only the features can fail; some with other pictures."""
    spec, sizes = _some_spec(rng), (*rng.choice(_GRIDS), rng.choice(_WIDTHS))
    frame, classes = textured(*rng.choice(_FRAMES)), rng.choice((_TWO, _THREE))
    try:
        content = _content(build_extractor(spec), Grid(*sizes), [frame], classes, weightless=True)
    except ToktError:  # a spec or a grid that cannot be built here: as a file it is tried
        members, manifest = _taken_apart(files)
        manifest["extractor"] = changed_json(spec, rng)
        grid = dict(zip(("rows", "cols", "width"), sizes, strict=True))
        return _put_together(members, text_of({**manifest, "grid": changed_json(grid, rng)}))
    made = {FILE: bundle_bytes(content)}
    return made if chance(rng, 70) else _with_pictures(made, lambda picture: some_picture(rng))


def _any(files: Files, rng: Random, others: Others) -> Files:
    return rng.choice((change_one, _zip, _manifest, _arrays, _fields))(files, rng, others)


KINDS = [
    Kind("bundle.bytes", small_bundles, _read_bundle, 18),
    Kind("bundle.zip", small_bundles, _read_bundle, 14, change=_zip),
    Kind("bundle.manifest", small_bundles, _read_bundle, 19, change=_manifest),
    Kind("bundle.fields", small_bundles, _read_bundle, 18, change=_fields),
    Kind("bundle.words", small_bundles, _read_bundle, 5, change=_words),
    Kind("bundle.arrays", small_bundles, _read_bundle, 13, change=_arrays),
    Kind("bundle.golden", small_bundles, _read_bundle, 6, change=_golden),
    Kind("bundle.signature", small_bundles, _read_bundle, 3, change=_signature),
    Kind("bundle.spec", small_bundles, _read_bundle, 3, few=5, change=_spec),
    Kind("bundle.real size", _real_bundles, _read_bundle, 1, few=3, change=_any),
]
