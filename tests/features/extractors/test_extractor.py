import json
from typing import Any

import cv2
import mahotas
import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.feature import local_binary_pattern

from tests.calls import refuses
from tokt.features.common.canonical import canonical_json, json_sha256
from tokt.features.extractors.extractor import Glcm, Join, Lbp, build_extractor, extractor_named
from tokt.features.extractors.named_extractors import NAMED
from tokt.features.extractors.textures import PLAIN_IMAGE, Context, Lines, Moments, Structure
from tokt.features.frames.grid import Grid
from tokt.features.kernels.quantization import Quantization

Image = NDArray[np.uint8]
GRID = Grid(4, 5, 110)
FLAT = Quantization(8, 64, 3, 21)
LBP_NAMES = [name for name, one in NAMED.items() if isinstance(one, Lbp) and one.image is None]


def looked_at(frame: Image, grid: Grid) -> Image:
    """The frame as the specs say: resized by area to the grid's width, then gray."""
    height, width = frame.shape[:2]
    size = (grid.width, height * grid.width // width)
    small = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_BGR2GRAY))


def crops(picture: NDArray[Any], grid: Grid) -> list[NDArray[Any]]:
    """The patches, cut out one by one."""
    high, wide = picture.shape[0] // grid.rows, picture.shape[1] // grid.cols
    return [
        picture[row * high : (row + 1) * high, col * wide : (col + 1) * wide].copy()
        for row in range(grid.rows)
        for col in range(grid.cols)
    ]


def histogram(codes: NDArray[Any], points: int) -> NDArray[np.float64]:
    return np.histogram(codes, bins=np.arange(points + 3))[0] / codes.size


@pytest.mark.parametrize("name", LBP_NAMES)
@pytest.mark.parametrize("kind", ["gray", "colour"])
def test_lbp_equals_scikit_image(name, kind, gray, colour):
    frame = gray if kind == "gray" else colour
    spec = NAMED[name].spec
    points, radius = spec["points"], spec["radius"]
    picture, circle = looked_at(frame, GRID), (points, radius, "uniform")
    if spec["border"] == "frame":
        maps = crops(local_binary_pattern(picture, *circle), GRID)
    else:
        maps = [local_binary_pattern(patch, *circle) for patch in crops(picture, GRID)]
    expected = np.array([histogram(codes, points) for codes in maps])
    found = extractor_named(name).describe(frame, GRID)
    assert found.dtype == np.float64
    assert np.array_equal(found, expected)
    assert np.allclose(found.sum(axis=1), 1, rtol=0, atol=1e-12)


@pytest.mark.parametrize("ignore_zeros", [False, True])
def test_haralick_equals_mahotas(ignore_zeros, gray, colour):
    for frame in (gray, colour):
        patches = crops(looked_at(frame, GRID), GRID)
        found = Glcm(ignore_zeros).describe(frame, GRID)
        assert found.shape == (20, 13) and found.dtype == np.float64
        for patch, row in zip(patches, found, strict=True):
            if ignore_zeros and not patch.any():
                continue
            expected = mahotas.features.haralick(patch, ignore_zeros=ignore_zeros).mean(axis=0)
            np.testing.assert_allclose(row, expected, rtol=1e-12, atol=1e-12)


GRAY_TOO = [name for name, extractor in NAMED.items() if not extractor.needs_colour]


@pytest.mark.parametrize("name", [*GRAY_TOO, "haralick+lbp_24_8_frame"])
def test_gray_as_bgr_is_the_same(name, gray):
    extractor = extractor_named(name)
    three = np.repeat(gray[:, :, None], 3, axis=2)
    found = extractor.describe(gray, GRID)
    assert np.array_equal(found, extractor.describe(three, GRID))
    assert found.shape == (GRID.n_patches, extractor.dim)
    assert len(set(extractor.names)) == extractor.dim


def test_join_is_hstack(colour):
    joined = extractor_named("haralick+lbp_24_8_frame+lbp")
    parts = [extractor_named(name) for name in ("haralick", "lbp_24_8_frame", "lbp")]
    side_by_side = np.hstack([part.describe(colour, GRID) for part in parts])
    assert np.array_equal(joined.describe(colour, GRID), side_by_side)
    assert joined.dim == 13 + 26 + 12
    assert joined.names == tuple(name for part in parts for name in part.names)


@pytest.mark.parametrize("value", [0, 1, 127, 255])
def test_even_patches_have_finite_features(value):
    frame, grid = np.full((60, 80), value, np.uint8), Grid(3, 4, 80)
    for ignore_zeros in (False, True):
        found = Glcm(ignore_zeros).describe(frame, grid)
        assert (found == found[0]).all()
        energy, contrast, correlation, entropy = found[0, [0, 1, 2, 8]]
        assert (energy, contrast, correlation, abs(entropy)) == (1, 0, 1, 0)
    others: list[Any] = [extractor_named(name) for name in LBP_NAMES]
    for image in (None, FLAT):
        others += [Structure(image), Lines((2, 64), image), Glcm(False, image, "log")]
    for part in (Glcm(False), Glcm(True), *others):
        assert np.isfinite(part.describe(frame, grid)).all()


@pytest.mark.parametrize(
    "frame",
    [
        *(np.zeros((60, 80), kind) for kind in (np.uint16, np.int8, np.float32, bool)),
        *(np.zeros(shape, np.uint8) for shape in ((60,), (60, 80, 1), (60, 80, 4), (2, 60, 80, 3))),
        *(np.zeros(shape, np.uint8) for shape in ((0, 80), (0, 0, 3), (1, 4000), (60000, 4))),
    ],
    ids=lambda frame: f"{frame.dtype} {frame.shape}",
)
def test_what_is_no_frame(frame):
    for name in ("lbp", "haralick", "lbp+haralick"):
        with pytest.raises((TypeError, ValueError)):
            extractor_named(name).describe(frame, Grid(4, 5, 2000))


SPECS = [
    *(extractor_named(name).spec for name in NAMED),
    Glcm(ignore_zeros=True).spec,
    extractor_named("haralick+lbp_24_8_frame").spec,
    Moments().spec,
    Moments(FLAT).spec,
    Glcm(False, FLAT).spec,
    Context(Lbp(8, 1, "frame", Quantization(8.5, 32)), "max").spec,
    Context(Join([Glcm(True, FLAT), Lbp(24, 8, "frame")]), "mean").spec,
    Join([Context(Glcm(True, FLAT), "range"), Lbp(24, 16, "frame")]).spec,
    Glcm(True, FLAT, "log").spec,
    Glcm(False, None, "linear").spec,
    Lbp(8, 5, "frame", FLAT, "nearest").spec,
    Lbp(8, 5, "patch", None, "bilinear").spec,
    Structure(FLAT).spec,
    Lines((2, 64), FLAT).spec,
]


@pytest.mark.parametrize("spec", SPECS, ids=json_sha256)
def test_spec_round_trip(spec, colour):
    again = build_extractor(json.loads(json.dumps(spec)))
    assert canonical_json(again.spec) == canonical_json(spec)
    assert again.describe(colour, GRID).shape == (20, again.dim)


LBP = Lbp(10, 5, "patch").spec


@pytest.mark.parametrize(
    ("words", "edits"),
    {
        "unknown extractor 'lpb'": [{"name": "lpb"}],
        "unknown extractor None": [{"name": None}],
        "unknown extractor": [{"name": ["lbp"]}],
        "missing in its spec: sampling": [{"version": 2}],
        **{f"version {no!r} is not": [{"version": no}] for no in (3, True, 1.0, "1")},
        "whole numbers": [{"points": 10.0}, {"points": True}, {"radius": None}],
        "out of range": [{"points": 3}, {"points": 10**12}, {"radius": 0}],
        "border": [{"border": "reflect"}, {"border": {}}],
        "image": [{"image": wrong} for wrong in ({}, None, {**PLAIN_IMAGE, "gain": 2})],
        "unknown or missing in its spec: gamma": [{"gamma": 2.2}],
    }.items(),
)
def test_refused_specs(words, edits):
    for edit in edits:
        refuses(words, build_extractor, {**LBP, **edit})
    for key in LBP:
        refuses("", build_extractor, {name: value for name, value in LBP.items() if name != key})


@pytest.mark.parametrize(
    ("spec", "words", "edits"),
    [
        (Glcm(True).spec, "ignore_zeros is true or false", {"ignore_zeros": [1]}),
        (Glcm(True).spec, "missing in its spec: scale", {"version": [2]}),
        (Glcm(True, None, "log").spec, "unknown .* spec: scale", {"version": [1]}),
        (Glcm(True, None, "log").spec, "scale is 'linear' or 'log'", {"scale": ["ln"]}),
        (Lbp(8, 2, "frame", None, "nearest").spec, "sampling is", {"sampling": [1]}),
        (Lines((8,)).spec, "samples is a list", {"samples": [8]}),
        (Lines((8,)).spec, "powers of 2", {"samples": [[], [16, 8], [8, 128], [8.0]]}),
        (Structure().spec, "version 2 is not known", {"version": [2]}),
    ],
)
def test_refused_specs_of_others(spec, words, edits):
    ((key, values),) = edits.items()
    for value in values:
        refuses(words, build_extractor, {**spec, key: value})


FLAT_JSON = FLAT.to_json()


@pytest.mark.parametrize(
    ("words", "key", "values"),
    [
        ("image", "resize", ["area"]),
        ("image", "gray", ["mean"]),
        ("image: unknown or missing in its spec: sharpen", "sharpen", [1]),
        ("gain is above 0", "gain", [0, float("nan"), True, "8"]),
        ("levels is a whole number, 8 to 256, not (7|64.0)", "levels", [7, 64.0]),
        ("smooth is an odd number", "smooth", [2, 0]),
        ("flatten is null or an object", "flatten", [61]),
        ("flatten: unknown or missing in its spec: by", "flatten", [{"window": 61}]),
        ("window is an odd number", "flatten", [{"window": w, "by": "ratio"} for w in (60, 257)]),
        ("flatten is by", "flatten", [{"window": 61, "by": "log"}]),
    ],
)
def test_refused_images(words, key, values):
    for value in values:
        refuses(words, build_extractor, {**LBP, "image": {**FLAT_JSON, key: value}})


@pytest.mark.parametrize(
    "parts", [None, 3, "lbp", {}, LBP, [], [LBP], [LBP, 1], [LBP, None], ["lbp", "lbp"], [LBP, {}]]
)
def test_refused_joins(parts):
    refuses("", build_extractor, {"name": "join", "version": 1, "parts": parts})


def test_a_join_of_joins_is_refused_at_any_depth():
    spec: dict[str, Any] = {"name": "join", "version": 1, "parts": [LBP, LBP]}
    for _ in range(5000):
        spec = {"name": "join", "version": 1, "parts": [spec, LBP]}
    refuses("cannot stand inside another join", build_extractor, spec)


def test_names():
    assert extractor_named("lbp").spec == extractor_named("lbp_10_5").spec == LBP
    for text in ("", "lbp+", "+", "lbp_10", "lbp haralick"):
        refuses("unknown extractor", extractor_named, text)


def test_context_is_what_the_neighbours_have(colour):
    part = Glcm(False, FLAT)
    alone = part.describe(colour, GRID).reshape(GRID.rows, GRID.cols, -1)
    for statistic, of in (("mean", np.mean), ("max", np.max), ("min", np.min), ("range", np.ptp)):
        found = Context(part, statistic).describe(colour, GRID)
        assert np.array_equal(found[:, :13].reshape(alone.shape), alone)
        for patch, row in enumerate(found[:, 13:]):
            y, x = divmod(patch, GRID.cols)
            box = np.s_[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
            itself = (y - box[0].start) * alone[box].shape[1] + x - box[1].start
            others = np.delete(alone[box].reshape(-1, 13), itself, axis=0)
            np.testing.assert_allclose(row, of(others, axis=0), rtol=1e-13, atol=1e-15)


def test_context_of_one_patch_is_itself(gray):
    alone = Lbp(8, 1, "patch").describe(gray, Grid(1, 1, None))
    for statistic, expected in (("mean", alone), ("max", alone), ("range", 0 * alone)):
        found = Context(Lbp(8, 1, "patch"), statistic).describe(gray, Grid(1, 1, None))
        assert np.array_equal(found, np.hstack([alone, expected]))


def test_moments_are_those_of_the_levels(colour):
    found = Moments().describe(colour, GRID)
    for patch, row in zip(crops(looked_at(colour, GRID), GRID), found, strict=True):
        percentiles = np.percentile(patch, (2, 10, 50, 90, 98), method="inverted_cdf")
        expected = [patch.mean(), patch.std(), patch.min(), patch.max(), *percentiles]
        np.testing.assert_allclose(row, expected, rtol=1e-12, atol=1e-12)


def test_version_2_of_lbp_and_haralick(colour):
    """A linear scale and bilinear sampling are version 1; a log scale changes five features."""
    one = Glcm(False).describe(colour, GRID)
    assert np.array_equal(Glcm(False, None, "linear").describe(colour, GRID), one)
    log = Glcm(False, None, "log").describe(colour, GRID)
    grow = [1, 3, 6, 9]
    np.testing.assert_allclose(np.exp(log[:, grow]) - 0.1, one[:, grow], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.tanh(log[:, 2]), one[:, 2].clip(-0.99, 0.9999), rtol=1e-12)
    rest = [0, 4, 5, 7, 8, 10, 11, 12]
    assert np.array_equal(log[:, rest], one[:, rest])
    same = Lbp(8, 2, "frame", None, "bilinear").describe(colour, GRID)
    assert np.array_equal(same, Lbp(8, 2, "frame").describe(colour, GRID))
    nearest = Lbp(8, 2, "frame", None, "nearest").describe(colour, GRID)
    assert not np.array_equal(same, nearest) and np.allclose(nearest.sum(axis=1), 1)


def test_a_line_is_seen_and_dots_are_not():
    """The same number of brighter pixels, in one row or anywhere."""
    rng = np.random.default_rng(8)
    dots, line = np.full((2, 60, 80), 128, np.uint8)
    line[30, 5:75] = 140
    dots.ravel()[rng.choice(dots.size, 70, replace=False)] = 140
    one = Grid(1, 1, None)
    ridge, strongest, one_way = Lines((16,)).describe(line, one)[0]
    dotted = Lines((16,)).describe(dots, one)[0]
    assert strongest > dotted[1] + 0.7 and one_way > dotted[2] + 0.7
    assert Structure().describe(line, one)[0, 2] > Structure().describe(dots, one)[0, 2] + 0.3
    turned = Lines((16,)).describe(line.T.copy(), one)[0]
    assert turned == pytest.approx([ridge, strongest, one_way], abs=0.1)


def test_a_spec_in_a_file(tmp_path):
    file = tmp_path / "my+spec.json"
    spec = Context(Glcm(False, FLAT), "mean").spec
    file.write_text(json.dumps(spec), encoding="utf-8")
    assert extractor_named(f"spec:{file}").spec == spec
    for content, words in (
        (b"", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b"3", "is an object, not int"),
        (json.dumps({**spec, "statistic": "mode"}).encode(), "statistic is one of"),
        (json.dumps({**spec, "part": spec}).encode(), "cannot stand inside another context"),
    ):
        file.write_bytes(content)
        assert refuses(words, extractor_named, f"spec:{file}").startswith(str(file))
    for missing in (tmp_path / "none.json", tmp_path):
        refuses(r"No such file|Is a directory", extractor_named, f"spec:{missing}")


def test_canonical_json():
    assert canonical_json({"b": [1, 2.5, None], "a": "ø"}) == '{"a":"\\u00f8","b":[1,2.5,null]}'
    assert json_sha256({"a": 1, "b": 2}) == json_sha256({"b": 2, "a": 1})
    for value in (float("nan"), float("inf")):
        with pytest.raises(ValueError):
            canonical_json({"a": value})
