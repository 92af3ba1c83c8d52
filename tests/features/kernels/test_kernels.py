"""The fast kernels against scikit-image, mahotas, exact arithmetic and each other."""

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.calls import refuses
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.kernels import reference
from tokt.features.kernels.dispatch import Kernels
from tokt.features.kernels.quantization import Quantization

from .drawn import Image, examples, paint, pictures
from .each_kernel import COMPILED_KERNELS, NUMPY_KERNELS, fast, needs_compiled
from .exact_haralick import exact_haralick, matrices, spreads

ONE = Grid(1, 1, None)
# Of a sum of counts and logarithms, relative to its terms; 9,000 of them gave 1.01e-13.
ROUNDING = 2e-13
BORDERS = st.sampled_from(("patch", "frame"))
CIRCLES = st.sampled_from(((10, 5), (24, 8), (8, 1), (16, 2), (4, 1.5), (12, 2.7))) | st.tuples(
    st.integers(1, 64), st.integers(1, 12) | st.floats(1e-3, 13) | st.just(200)
)


def same_bits(one: NDArray[Any], two: NDArray[Any]) -> bool:
    return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()


def described(kernels: Kernels, gray: Image, grid: Grid, threads: int = 1) -> list[NDArray[Any]]:
    """Everything the kernels compute from a gray picture, and smaller pictures of it."""
    height, width = gray.shape
    plain = np.asarray(gray)
    bgr = np.stack([plain, plain[::-1], plain[:, ::-1]], axis=2)
    ranges = [np.array([[0, 1], [side // 3, side], [0, side // 2]]) for side in gray.shape]
    gray16 = kernels.resized_gray16(bgr, height * 5 // 7, width * 2 // 3, threads)
    return [
        kernels.lbp_counts(gray, grid, 10, 5, "patch", threads),
        kernels.lbp_counts(gray, grid, 7, 1.5, "frame", threads),
        kernels.haralick_features(gray, grid, False, threads),
        kernels.haralick_features(gray, grid, True, threads),
        kernels.resized_gray(gray, height * 5 // 8, width * 3 // 4, threads),
        kernels.resized_gray(bgr, height * 5 // 7, width * 2 // 3, threads),
        kernels.resized_gray16(gray, height * 3 // 2, width, threads),
        gray16,
        kernels.quantize(gray16, Quantization(8, 256, 3, 21), threads),
        kernels.quantize(gray16, Quantization(0.7, 32, 1, 255, "ratio"), threads),
        kernels.level_counts(gray, grid, threads),
        kernels.lbp_nearest_counts(gray, grid, 8, 5, "patch", threads),
        kernels.lbp_nearest_counts(gray, grid, 8, 13, "frame", threads),
        kernels.structure_sums(gray, grid, threads),
        kernels.gradient_sums(257 * plain.astype(np.uint16), grid, 5, threads),
        kernels.box_sums(bgr, *ranges, threads),
        kernels.line_sums(gray, grid, 128, (2, 16), threads),
        *kernels.row_marks(plain.repeat(8, axis=1), np.arange(width, dtype=np.uint64)[None], 2, 8),
    ]


# Local binary patterns: identical integers.


@fast
@examples(200)
@given(drawn=pictures(), circle=CIRCLES, border=BORDERS)
def test_lbp_equals_scikit_image(kernels, drawn, circle, border):
    gray, grid = drawn
    found = kernels.lbp_counts(gray, grid, *circle, border)
    assert same_bits(found, reference.lbp_counts(gray, grid, *circle, border))


@fast
@pytest.mark.parametrize("border", ["patch", "frame"])
@pytest.mark.parametrize(
    "circle",
    [(1, 1), (2, 1.5), *((points, 3) for points in (10, 11, 12, 13, 16, 17, 31, 32, 33, 63, 64))],
)
def test_every_number_of_points_fits(kernels, circle, border):
    gray, grid = paint("few levels", (70, 140), 5, 100, 0), Grid(2, 1, None)
    found = kernels.lbp_counts(gray, grid, *circle, border)
    assert same_bits(found, reference.lbp_counts(gray, grid, *circle, border))
    assert (found.sum(axis=1) == 35 * 140).all()


# Haralick: exact arithmetic, and mahotas where mahotas is accurate.


@fast
@examples(100)
@given(drawn=pictures(4_000), ignore_zeros=st.booleans())
def test_haralick_is_exact(kernels, drawn, ignore_zeros):
    gray, grid = drawn
    found = kernels.haralick_features(gray, grid, ignore_zeros)
    assert found.dtype == np.float64 and found.shape == (grid.n_patches, 13)
    for patch, row in zip(grid.cells(gray), found, strict=True):
        expected, allowed = exact_haralick(patch, ignore_zeros, ROUNDING)
        assert (np.abs(row - expected) <= allowed).all(), (row, expected, allowed)


@fast
@pytest.mark.parametrize("high", [1, 17, 254, 255])
@pytest.mark.parametrize("ignore_zeros", [False, True])
def test_bright_patches_with_one_other_pixel_are_exact(kernels, high, ignore_zeros):
    """Here a variance from the mean of squares has no digit left."""
    patch = np.full((80, 150), high, np.uint8)
    patch[40, 70] -= 1
    found = kernels.haralick_features(patch, ONE, ignore_zeros)[0]
    expected, allowed = exact_haralick(patch, ignore_zeros, ROUNDING)
    assert (np.abs(found - expected) <= allowed).all()


def mahotas_is_accurate(patch: Image, ignore_zeros: bool) -> bool:
    """Not bright and nearly constant, in the grey levels or in the sums of two neighbours.

    mahotas takes variances as the mean of squares less the square of the mean; these keep 9
    digits while they are more than 1e-4 of what is subtracted. (A checkerboard's sums are
    constant although its levels are not.)
    """
    return all(
        mean**2 <= 1e4 * min(variance, sum_variance)
        for mean, variance, sum_variance in map(spreads, matrices(patch, ignore_zeros))
    )


@examples(100)
@given(drawn=pictures(8_000), ignore_zeros=st.booleans())
def test_haralick_equals_mahotas(drawn, ignore_zeros):
    """To 1e-9 of the feature; of 1 for the correlation, which may be 0.

    Besides, mahotas gives 1e-16 for an entropy of 0, and the information measures magnify its
    rounding where neighbours tell nothing about each other. All kernels on each example: mahotas
    takes most of the time.
    """
    gray, grid = drawn
    here = [kernels for kernels in (COMPILED_KERNELS, NUMPY_KERNELS) if kernels]
    found = [kernels.haralick_features(gray, grid, ignore_zeros) for kernels in here]
    expected = reference.haralick_features(gray, grid, ignore_zeros)
    for patch, two, *ones in zip(grid.cells(gray), expected, *found, strict=True):
        if not mahotas_is_accurate(patch, ignore_zeros):
            continue
        for one in ones:
            allowed = 1e-9 * np.abs(two) + ROUNDING
            allowed[2] = 1e-9
            if not (np.abs(one - two) <= allowed).all():  # the 50 digits take their time
                allowed += exact_haralick(patch, ignore_zeros, ROUNDING)[1]
                allowed[2] = 1e-9
            assert (np.abs(one - two) <= allowed).all(), (one, two, allowed)


IGNORING = {
    "zeros alone": np.zeros((6, 8)),
    "no pair across": np.eye(8)[2][None].T @ np.ones((1, 8)) * 9,
    "no pair down": np.ones((8, 1)) @ np.eye(8)[2][None] * 9,
    "one pixel": np.outer(np.eye(6)[3], np.eye(8)[5]) * 200,
    "two by two": np.pad(np.arange(1, 5).reshape(2, 2), 2) * 30,
    "zeros in a corner": np.pad(np.arange(1, 21).reshape(4, 5), ((2, 0), (3, 0))),
}


@fast
@pytest.mark.parametrize("name", IGNORING)
def test_ignoring_zeros(kernels, name):
    """Where a direction has no pair left, the features with the zeros counted."""
    patch = np.asarray(IGNORING[name], np.uint8)
    found = kernels.haralick_features(patch, ONE, True)[0]
    expected, allowed = exact_haralick(patch, True, ROUNDING)
    assert (np.abs(found - expected) <= allowed).all()
    theirs = reference.haralick_features(patch, ONE, True)[0]
    np.testing.assert_allclose(found, theirs, rtol=1e-9, atol=1e-7)
    counted = kernels.haralick_features(patch, ONE, False)[0]
    empty = name in ("zeros alone", "no pair across", "no pair down", "one pixel")
    assert same_bits(found, counted) == empty


# One result, whatever runs it.


@pytest.fixture
def levels():
    """Runs a function at each instruction level of this processor."""
    native = pytest.importorskip("tokt.features.kernels._native", reason="not built here")

    def run(function: Any) -> list[Any]:
        results = []
        for name in native.INSTRUCTIONS:
            native.use_instructions(name)
            results.append(function())
        return results

    yield run
    native.use_instructions(native.INSTRUCTIONS[-1])


@needs_compiled
def test_every_instruction_level_gives_the_same_bits(levels):
    @examples(60)
    @given(drawn=pictures(), circle=CIRCLES, border=BORDERS)
    def check(drawn: tuple[Image, Grid], circle: tuple[int, float], border: str) -> None:

        def everything() -> list[NDArray[Any]]:
            found = COMPILED_KERNELS.lbp_counts(*drawn, *circle, border)
            return [found, *described(COMPILED_KERNELS, *drawn)]

        first, *others = levels(everything)
        for other in others:
            assert all(map(same_bits, first, other))

    check()


@fast
@examples(40)
@given(drawn=pictures())
def test_any_number_of_threads_gives_the_same_bits(kernels, drawn):
    """More threads than rows of patches among them."""
    alone = described(kernels, *drawn)
    for threads in (2, 3, 7):
        assert all(map(same_bits, alone, described(kernels, *drawn, threads)))


@fast
def test_threads_of_the_caller(kernels):
    """Several Python threads, pictures of several sizes, each with two threads of its own."""
    work = [
        (paint("noise", (3 * high, 4 * wide), high, 0, 0), Grid(3, 4, None))
        for high, wide in [(3, 5), (40, 80), (27, 36), (33, 65), (8, 129), (70, 9)] * 2
    ]
    expected = [described(kernels, *one) for one in work]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda one: described(kernels, *one, 2), work))
    for one, two in zip(expected, found, strict=True):
        assert all(map(same_bits, one, two))


@pytest.mark.skipif(os.name == "nt", reason="no fork on this system")
@fast
def test_threads_after_a_fork(kernels):
    """The child has the parent's pool, but none of its threads."""
    gray, grid = paint("noise", (90, 120), 3, 0, 0), Grid(3, 4, None)
    expected = described(kernels, gray, grid, 3)
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe()
    child = fork.Process(target=lambda: there.send(described(kernels, gray, grid, 3)))
    child.start()
    try:
        assert here.poll(60), "the child waits for threads it does not have"
        assert all(map(same_bits, expected, here.recv()))
    finally:
        child.kill()
        child.join()


# What is not a gray picture in C order.


def views() -> Iterator[tuple[str, Any]]:
    whole = paint("noise", (61, 83), 9, 0, 0)
    read_only = whole.copy()
    read_only.flags.writeable = False
    yield "Fortran order", np.asfortranarray(whole)
    yield "transposed", whole.T
    yield "upside down", whole[::-1]
    yield "mirrored", whole[:, ::-1]
    yield "every second column", whole[:, ::2]
    yield "every second row", whole[::2]
    yield "cut out", whole[5:55, 7:60]
    yield "read only", read_only
    yield "repeated row", np.broadcast_to(whole[3], (40, 83))
    yield "unaligned", np.frombuffer(b"x" + whole.tobytes(), np.uint8, offset=1).reshape(61, 83)
    yield "matrix", whole.view(np.matrix)
    yield "masked", np.ma.masked_array(whole, whole > 200)


@fast
@pytest.mark.parametrize(("name", "view"), list(views()), ids=lambda value: str(value)[:20])
def test_any_layout_gives_what_its_copy_gives(kernels, name, view):
    copy = np.array(view, np.uint8, order="C", subok=False)
    before = copy.copy()
    grid = Grid(3, 2, None)
    found = described(kernels, view, grid)
    assert all(type(one) is np.ndarray for one in found)
    assert all(map(same_bits, found, described(kernels, copy, grid)))
    assert np.array_equal(np.array(view, subok=False), before), name


PIXELS = np.zeros((30, 40), np.uint8)
NOT_GRAY: dict[str, Any] = {
    **{kind: PIXELS.astype(kind) for kind in ("float64", "int16", "int8", "bool", "object")},
    "nothing": None,
    "list": PIXELS.tolist(),
    "bytes": PIXELS.tobytes(),
    "memory": memoryview(PIXELS),
    "one number": np.uint8(3),
    "no dimension": np.array(3, np.uint8),
    "one dimension": PIXELS[0],
    "four dimensions": PIXELS[None, :, :, None],
    "two channels": np.zeros((30, 40, 2), np.uint8),
    "four channels": np.zeros((30, 40, 4), np.uint8),
    **{f"{shape}": np.zeros(shape, np.uint8) for shape in ((0, 0), (0, 40), (30, 0), (0, 40, 3))},
}
FIRST = np.array([[0, 1]])
Calls = list[tuple[str, Any]]


def calls(kernels: Kernels, *more: Any) -> Calls:
    """The kernels as functions of a picture alone, with a number of threads or without."""
    return [
        ("lbp", lambda picture: kernels.lbp_counts(picture, ONE, 8, 1, "patch", *more)),
        ("frame", lambda picture: kernels.lbp_counts(picture, ONE, 8, 1, "frame", *more)),
        ("haralick", lambda picture: kernels.haralick_features(picture, ONE, False, *more)),
        ("counts", lambda picture: kernels.level_counts(picture, ONE, *more)),
        ("nearest", lambda picture: kernels.lbp_nearest_counts(picture, ONE, 8, 1, "patch", *more)),
        ("structure", lambda picture: kernels.structure_sums(picture, ONE, *more)),
        ("lines", lambda picture: kernels.line_sums(picture, ONE, 128, (2, 4), *more)),
        ("area_boxes", lambda picture: kernels.box_sums(picture, FIRST, FIRST, *more)),
        ("area", lambda picture: kernels.resized_gray(picture, 7, 9, *more)),
        ("area_deep", lambda picture: kernels.resized_gray16(picture, 7, 9, *more)),
    ]


@fast
@pytest.mark.parametrize("name", NOT_GRAY)
def test_no_picture(kernels, name):
    for _, call in calls(kernels):
        with pytest.raises((TypeError, ValueError, ToktError)):
            call(NOT_GRAY[name])


@fast
def test_bgr_has_no_texture(kernels):
    for name, call in calls(kernels):
        if not name.startswith("area"):
            with pytest.raises(ValueError):
                call(np.zeros((30, 40, 3), np.uint8))


@fast
@pytest.mark.parametrize("rows", [4, 10**30])  # with what fits into no memory
@pytest.mark.parametrize("shape", [(8, 40), (40, 8), (1, 1), (11, 12)])
def test_patches_under_3_pixels(kernels, shape, rows):
    gray, grid = np.zeros(shape, np.uint8), Grid(rows, 4, None)
    for border in ("patch", "frame"):
        refuses("least is 3x3", kernels.lbp_counts, gray, grid, 8, 1, border)
        refuses("least is 3x3", kernels.lbp_nearest_counts, gray, grid, 8, 1, border)
    refuses("least is 3x3", kernels.haralick_features, gray, grid, False)
    refuses("least is 3x3", kernels.structure_sums, gray, grid)
    refuses("least is 3x3", kernels.line_sums, gray, grid, 128, (2, 4))


@fast
@pytest.mark.parametrize(
    ("points", "radius", "border"),
    [
        *((points, 1, "patch") for points in (0, -1, 65, 10**30, True, 3.0, None, "8")),
        *((8, radius, "frame") for radius in (0, -1, np.nan, np.inf, -np.inf, 1e9, None, "1", 1j)),
        *((8, 1, border) for border in ("x", "", None, 1, b"patch")),
    ],
)
def test_lbp_options_out_of_range(kernels, points, radius, border):
    with pytest.raises((TypeError, ValueError)):
        kernels.lbp_counts(PIXELS, ONE, points, radius, border)


@fast
@pytest.mark.parametrize("threads", [0, -1, 1.5, True, None, "2"])
def test_threads_out_of_range(kernels, threads):
    deep = PIXELS.astype(np.uint16)
    for _, call in [
        *calls(kernels, threads),
        ("levels", lambda _: kernels.quantize(deep, Quantization(1), threads)),
        ("gradients", lambda _: kernels.gradient_sums(deep, ONE, 3, threads)),
    ]:
        with pytest.raises((TypeError, ValueError)):
            call(PIXELS)
