"""The texture figures of tokt reproduce on a small rendered mission, and what they are made of."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tokt_studies.baselines.thesis_centre import leaves_frame
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.exhibits import centre_figures, training_image_figures
from tokt_studies.thesis.exhibits.centre_figures import both_ways, centre_and_box
from tokt_studies.thesis.exhibits.dot_figures import by_thesis, prediction_dots
from tokt_studies.thesis.exhibits.exhibit import ClaimAgreement, Exhibit
from tokt_studies.thesis.exhibits.patch_figures import patch_histograms
from tokt_studies.thesis.exhibits.training_image_figures import BinKind, bin_kinds, training_images
from tokt_studies.thesis.methods.mission_models import TOKT_TEXTURE, learnt_from_labels
from tokt_studies.thesis.patch_scores import (
    PatchScore,
    patches_of_mask,
    pooled_score,
    score_patches,
    truth_by_mask,
)

pytestmark = pytest.mark.xdist_group("reproduce")

HEIGHT, WIDTH = 271, 360


@pytest.fixture
def context(judged):
    """What the exhibits share, with the thesis's models' judgements put in."""
    return judged


@pytest.fixture(autouse=True)
def undrawn(request, monkeypatch):
    """Figures are put together, but not even coarsely drawn where a test does not ask for it."""
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", lambda figure, buffer, **_: buffer.write(b"none"))


@pytest.fixture(autouse=True)
def one_small_scene(monkeypatch):
    monkeypatch.setattr(centre_figures, "SCENES", (1,))
    monkeypatch.setattr(centre_figures, "FULL_WIDTH", WIDTH)


@pytest.fixture
def drawn():
    """Figures are drawn, coarsely."""


def white(*blocks: Any) -> NDArray[np.uint8]:
    """A mask of the grid's size with some white blocks."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    for block in blocks:
        mask[block] = 255
    return mask


def test_bins_are_flat_edge_and_corner_as_in_scikit_images_example():
    """P = 24: two points of the circle around none, a quarter, half, three quarters and all."""
    kinds = bin_kinds(24)
    assert len(kinds) == 26
    places = {kind: [i for i, its in enumerate(kinds) if its == kind] for kind in BinKind}
    assert places[BinKind.FLAT] == [0, 1, 2, 22, 23, 24]
    assert places[BinKind.EDGE] == [10, 11, 12, 13, 14]
    assert places[BinKind.CORNER] == [4, 5, 6, 7, 8, 16, 17, 18, 19, 20]
    assert places[BinKind.NOT_UNIFORM] == [25]
    assert bin_kinds(10).count(BinKind.EDGE) == 1
    assert [str(kind) for kind in bin_kinds(10)].count("between") == 4


def test_scores_of_patches_leave_out_what_is_not_sure():
    """Precision, recall and F1 of counts; undefined is not zero."""
    truth = np.array([1, 1, 0, 0, -1], np.int8)
    score = score_patches(np.array([1, 0, 1, 0, 0], bool), truth)
    assert score == PatchScore(1, 1, 1)
    assert (score.precision, score.recall, score.f1) == (0.5, 0.5, 0.5)
    nothing = score_patches(np.zeros(5, bool), np.zeros(5, np.int8))
    assert (nothing.precision, nothing.recall, nothing.f1) == (None,) * 3


def test_a_mask_says_obstacle_from_a_tenth_of_a_patch_on():
    """Patches are 36x27: 97.2 pixels are a tenth; less is not scored; a shifted mask differs."""
    mask = white(np.s_[0:27, 0:4], np.s_[27:54, 0:3])
    truth = truth_by_mask(mask)
    assert np.flatnonzero(truth == 1).tolist() == [0]
    assert np.flatnonzero(truth < 0).tolist() == [10]
    assert np.flatnonzero(patches_of_mask(mask)).tolist() == [0]
    shifted = truth_by_mask(np.roll(mask, 36, axis=1))
    assert score_patches(shifted == 1, truth).hits == 0


def test_the_thesiss_ypos_is_from_cx_and_the_corrected_one_from_cy():
    """One block low on the right: both centres are right, and only one way up is."""
    mask = white(np.s_[200:241, 250:291])
    both = both_ways(mask)
    assert (both.thesis.cx, both.thesis.cy) == (270, 220)
    assert (both.thesis.x, both.thesis.y) == (-(270 - 180), -(270 - 135))
    assert (both.corrected.x, both.corrected.y) == (-(270 - 180), -(220 - 135))
    high = both_ways(mask[::-1])
    assert high.thesis.y < 0 < (high.corrected.y or 0)


def test_the_thesiss_box_is_a_sum_and_the_corrected_one_a_union():
    """Two blocks apart: the sum misses the second; three tall ones leave the frame."""
    mask = white(np.s_[50:71, 40:61], np.s_[150:171, 240:261])
    apart = both_ways(mask)
    assert apart.corrected.box == (40, 50, 221, 121)
    assert apart.thesis.box == (38, 48, 50, 50)
    assert apart.thesis_misses
    assert not apart.thesis_leaves
    tall = both_ways(white(*(np.s_[100:201, x : x + 21] for x in (20, 120, 220))))
    assert tall.thesis.box == (18, 98, 75, 315)
    assert tall.thesis_leaves
    assert leaves_frame((0, 0, WIDTH, HEIGHT), HEIGHT, WIDTH) is False


@pytest.fixture
def one_photo(monkeypatch):
    """Fewer images to choose from, for speed."""
    monkeypatch.setattr(training_image_figures, "_PHOTOS", ("brick",))


def _sound(exhibit: Exhibit) -> None:
    """What every exhibit has: pictures that decode, and claims."""
    assert exhibit.claims
    for plot in exhibit.plots:
        picture = cv2.imdecode(np.frombuffer(plot.png, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        assert picture.std() > 5
        assert plot.caption


def test_training_images(context, one_photo, drawn):
    """Another ocean frame is the worst to learn from; each claim has its figures."""
    exhibit = training_images(context)
    _sound(exhibit)
    table = exhibit.tables[0].frame.set_index("image")
    assert {"other", "brick", "branches", "structure frame", "ocean frame"} == set(table.index)
    assert table.loc["ocean frame", "F1"] < table["F1"].max() / 2
    assert table["rows alike"].is_monotonic_increasing
    kinds = table[[str(kind) for kind in BinKind]]
    assert kinds.sum(axis=1).to_numpy() == pytest.approx(1)
    assert f"{table.loc['brick', 'edge']:.1%}" in exhibit.claims[1].found


def test_patch_histograms(context, drawn):
    """The tower's patch looks unlike the water's."""
    exhibit = patch_histograms(context)
    _sound(exhibit)
    assert exhibit.claims[0].agreement is not ClaimAgreement.NO


def test_prediction_dots(context, drawn):
    """The dots agree with the labels; the claim is of the thesis's methods alone."""
    exhibit = prediction_dots(context)
    _sound(exhibit)
    frame, truth = context.left(context.structure_frame), context.truth(context.structure_frame)
    said = {one.title: one.score(truth) for one in by_thesis(context, frame)}
    assert list(said) == ["LBP (10, 5)", "LBP (24, 8)", "Haralick"]
    assert said["Haralick"].f1 > 0.7
    assert f"Haralick {said['Haralick'].f1:.2f}" in exhibit.claims[0].found
    moved = {
        number: np.roll(said.reshape(10, 10), 3, axis=1).ravel()
        for number, said in context.curves.patches[TOKT_TEXTURE].items()
    }
    assert (pooled_score(moved, context.truths).f1 or 0.0) < 0.5


def test_centre_and_box(context, drawn):
    """Every frame with status 1 is in the figures, and these follow from its masks."""
    exhibit = centre_and_box(context)
    _sound(exhibit)
    size = GRID.resized(*context.left(context.structure_frame).shape[:2])
    ways = [
        both_ways(GRID.paint(patches, *size))
        for key in context.thesis
        for patches in context.curves.patches[key].values()
        if patches.any()
    ]
    leave = sum(way.thesis_leaves for way in ways)
    assert len(ways) > 6
    assert f"Of {len(ways)} boxes {leave} leave the frame" in exhibit.claims[0].found


def test_our_model_learns_from_nothing_near_the_picture(context, monkeypatch):
    """A dark frame of the mission itself is held out with its embargo."""
    read: list[int] = []
    decoded: Callable[..., object] = context.decoded

    def watched(numbers: list[int]) -> object:
        read.extend(numbers)
        return decoded(numbers)

    proof = context.any_picture()  # what the bundle proves itself with is not learnt
    monkeypatch.setattr(context, "any_picture", lambda: proof)
    monkeypatch.setattr(context, "decoded", watched)
    learnt_from_labels(context, near=10)
    assert read
    assert all(abs(number - 10) > 5 for number in read)
