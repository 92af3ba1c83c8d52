"""Each claim of the exhibits comes out as agreed, agreed in part, not agreed or not to be had."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from tokt_studies.thesis.exhibits.calibration_figures import bend_claim, row_claim
from tokt_studies.thesis.exhibits.centre_figures import (
    BothWays,
    both_ways,
    box_claim,
    fineness_claim,
)
from tokt_studies.thesis.exhibits.curve_figures import order_claim
from tokt_studies.thesis.exhibits.disparity_figures import cloud_claim, map_claim
from tokt_studies.thesis.exhibits.dot_figures import alike_claim
from tokt_studies.thesis.exhibits.exhibit import Claim, ClaimAgreement
from tokt_studies.thesis.exhibits.invariance import (
    GAIN,
    GAMMA,
    NOISE,
    QUARTER,
    SMALL,
    haralick_claim,
    lbp_claim,
)
from tokt_studies.thesis.exhibits.light_figures import low_light_claim
from tokt_studies.thesis.exhibits.margin_figures import SWEEP, line_claim, sweep_claim
from tokt_studies.thesis.exhibits.patch_figures import histogram_claim
from tokt_studies.thesis.exhibits.superpixel_figure import mask_claim
from tokt_studies.thesis.exhibits.training_image_figures import (
    Image,
    spike_claim,
    structure_claim,
    variety_claim,
)

GRADES = ("YES", "PARTLY", "NO", "UNAVAILABLE")
Judged = Iterator[tuple[Claim, str]]
"""Claims, each with the agreement that is right."""


def image_of(flat: float, edge: float) -> Image:
    """An image whose patches all have these shares of LBP (10, 5)'s bins; the rest is corners."""
    histogram = np.zeros((4, 12))
    histogram[:, [0, 5, 2]] = flat, edge, 1 - flat - edge
    return Image("made", "", np.zeros((2, 2), np.uint8), {"lbp_10_5": histogram})


def training_images() -> Judged:
    for ocean, structure, right in (
        ((0.7, 0.1), (0.6, 0.2), "YES"),
        ((0.7, 0.1), (0.8, 0.1), "PARTLY"),
        ((0.2, 0.1), (0.1, 0.3), "PARTLY"),
        ((0.2, 0.3), (0.3, 0.2), "NO"),
    ):
        yield structure_claim(image_of(*ocean), image_of(*structure)), right
    spikes = (0.1, 0.2, 0.4), (0.1, 0.4, 0.2), (0.3, 0.4, 0.2)
    for edges, right in zip(spikes, GRADES, strict=False):
        yield spike_claim(*(image_of(0.3, edge) for edge in edges)), right
    scores = [0.9, 0.7, 0.5, 0.4, 0.1], [0.9, 0.7, 0.5, 0.0, 1.0], [0.1, 0.4, 0.5, 0.7, 0.9]
    for f1, right in zip((*scores, [None] * 5), GRADES, strict=True):
        table = pd.DataFrame({"rows alike": [0.1, 0.2, 0.3, 0.4, 0.5], "F1": f1})
        table["image"] = ["coffee", "brick", "grass", "structure frame", "ocean frame"]
        yield variety_claim(table), right


def patches_that_differ(lbp_by: float, haralick_by: float) -> dict[str, NDArray[np.float64]]:
    """Patch 0 of the structure, whose LBP and Haralick features differ so much from ocean's."""
    rng = np.random.default_rng(4)
    lbp = 1 / 12 + rng.uniform(-0.01, 0.01, (100, 12))
    lbp[0, 0] += lbp_by
    haralick = rng.normal(5, 1, (100, 13))
    haralick[0] += haralick_by
    normed = lbp / lbp.sum(axis=1, keepdims=True)
    return {"lbp_10_5": normed, "lbp_24_8": normed, "haralick": haralick}


def masked(*blocks: Any) -> BothWays:
    """A mask of the grid's size with some white blocks."""
    mask = np.zeros((271, 360), np.uint8)
    for block in blocks:
        mask[block] = 255
    return both_ways(mask)


def patches_and_masks() -> Judged:
    clear = np.arange(100) > 0
    differing = (
        (0.3, 12.0, clear),
        (0.3, 0.0, clear),
        (0.0, 0.0, clear),
        (0.3, 12.0, clear & ~clear),
    )
    for (lbp_by, haralick_by, known), right in zip(differing, GRADES, strict=True):
        rows = patches_that_differ(lbp_by, haralick_by)
        yield histogram_claim(rows, {"structure": 0, "ocean": 99}, known), right
    for marked, right in zip((10, 6, 2, 0), GRADES, strict=True):
        lbp, haralick = (np.arange(100) < count for count in (marked, 10 if marked else 0))
        yield alike_claim({"lbp_10_5": {3: lbp}, "haralick": {3: haralick}}, [3]), right
    for first, second, right in ((0.8, 0.7, "YES"), (0.8, 0.5, "PARTLY"), (0.6, 0.5, "NO")):
        yield fineness_claim([(first, 0.6), (second, 0.6)]), right
    one = masked(np.s_[100:141, 50:91])
    apart = masked(np.s_[50:71, 40:61], np.s_[150:171, 240:261])
    for boxes, right in zip(([one], [one] * 19 + [apart], [one, apart], []), GRADES, strict=True):
        yield box_claim(boxes), right


def superpixels() -> Judged:
    printed = {"overlap": 0.7, "slic_f1": 0.7, "grid_f1": 0.75, "area_ratio": 1.3}
    printed |= {"slic_contours": 20, "grid_contours": 9}
    against = {"area_ratio": 0.9, "grid_contours": 20, "slic_f1": 0.9, "overlap": 0.2}
    for other, right in (
        ({}, "YES"),
        *(({key: value}, "PARTLY") for key, value in against.items()),
        ({**against, "overlap": 0.7, "grid_contours": 9}, "PARTLY"),
        ({**against, "overlap": 0.7}, "NO"),
        ({"overlap": None}, "UNAVAILABLE"),
    ):
        yield mask_claim(printed | other), right


def map_of(*columns: int) -> NDArray[np.uint8]:
    """A map that is white in some columns."""
    found = np.zeros((1024, 1360), np.uint8)
    found[:, list(columns)] = 255
    return found


def stereo() -> Judged:
    parts = (0.9, 0.5), (0.9, 0.0), (0.0, 0.5), (None, 0.5)
    for (share, changed), right in (*zip(parts, GRADES, strict=True), ((0.2, 0.5), "PARTLY")):
        numbers = {"points_searched": share, "thesis_pixels_changed_most": changed}
        counts = {"matched_points": 90, "wrong_pairs": 4, "thesis_status_kept": 4}
        yield map_claim(numbers | counts), right
    clouds = (0.9, 0.0, 3.0), (0.9, -0.9, 3.0), (0.3, 0.0, 0.1), (None, 0.0, 3.0)
    for of_one, right in (*zip(clouds, GRADES, strict=True), ((0.3, 0.0, 3.0), "PARTLY")):
        names = ("in_place", "rank_correlation", "thesis_cloud_spread")
        said = dict(zip(names, of_one, strict=True))
        yield cloud_claim(said | {"cloud_spread": 0.2, "shown_frame": 3}), right
    lines = [map_of(1250, 1251)] * 2, [map_of(1250), map_of(1300)], [map_of(20)] * 2, []
    for maps, right in (*zip(lines, GRADES, strict=True), ([map_of(), map_of()], "NO")):
        yield line_claim(maps), right
    falls = np.linspace(9, 2, len(SWEEP)), [9, 8, 7, 7, 6, 5, 4, 3], np.linspace(2, 9, len(SWEEP))
    for shares, right in (*zip(falls, GRADES, strict=False), ([5] * len(SWEEP), "NO")):
        sweep = pd.DataFrame([shares], columns=list(SWEEP))
        yield sweep_claim(sweep), right
    yield sweep_claim(sweep[:0]), "UNAVAILABLE"


def calibration() -> Judged:
    for after, right in zip((4.0, 30.0, 64.0), GRADES, strict=False):
        row = {"frame": [1], "matches": [90], "raw": 82.0, "thesis": after, "tokt": 0.3}
        yield row_claim(pd.DataFrame(row)), right
    yield row_claim(pd.DataFrame(row)[:0]), "UNAVAILABLE"
    yield bend_claim(np.tile([0.01, 0.009, 0.02], (30, 1))), "PARTLY"
    yield bend_claim(np.empty((0, 3))), "UNAVAILABLE"


def shares_of(lbp: list[float], lbp_24: list[float], haralick: list[float]) -> pd.DataFrame:
    """Shares of verdicts that changed, by change."""
    columns = {"lbp_10_5": lbp, "lbp_24_8": lbp_24, "haralick": haralick}
    return pd.DataFrame(columns, index=[GAMMA, GAIN, QUARTER, *SMALL, NOISE])


def changes_and_light() -> Judged:
    still, turned, noisy = [0.0] * 6, [0.0, 0.0, 0.2, 0.0, 0.0, 0.0], [0.0] * 5 + [0.9]
    pairs = (still, still), (turned, still), (turned, turned)
    for (lbp, lbp_24), right in (*zip(pairs, GRADES, strict=False), ((noisy, still), "YES")):
        yield lbp_claim(shares_of(lbp, lbp_24, still)), right
    for turns, noise, right in ((0.2, 0.2, "YES"), (0.2, 0.0, "PARTLY"), (0.0, 0.0, "NO")):
        changed = [0.0, 0.0, turns, turns, turns, noise]
        yield haralick_claim(shares_of(still, still, changed)), right
    for f1, mean, right in (
        (0.2, 0.4, "YES"),
        (0.2, 9.0, "PARTLY"),
        (0.9, 0.4, "PARTLY"),
        (0.9, 9.0, "NO"),
    ):
        row = {"LBP (10, 5)": 0.5, "Haralick": 0.6, "disparity": f1}
        means = {"LBP (10, 5), mean": 5.0, "Haralick, mean": 5.0, "disparity, mean": mean}
        lit = {"light": 1.0, **dict.fromkeys(row, 1.0), **dict.fromkeys(means, 0.4)}
        yield low_light_claim(pd.DataFrame([lit, {"light": 0.5, **row, **means}])), right


def first_detections() -> Judged:
    """One that never sees what another does is not first; nor are two that do not together."""
    for *seen, right in (
        (157, 151, 155, "YES"),
        (157, 151, 170, "PARTLY"),
        (150, 151, 152, "NO"),
        (None, 151, 152, "PARTLY"),
        (157, None, 155, "NO"),
        (None, None, 152, "NO"),
        (None, None, None, "UNAVAILABLE"),
    ):
        names = ("lbp_10_5", "haralick", "disparity")
        yield order_claim(dict(zip(names, seen, strict=True))), right


ALL = (training_images, patches_and_masks, superpixels, stereo, calibration, changes_and_light)


@pytest.mark.parametrize("claims", (*ALL, first_detections))
def test_a_claim_comes_out_as_it_is(claims):
    for claim, right in claims():
        assert claim.agreement is ClaimAgreement[right], claim
        assert claim.what and claim.printed and claim.found and claim.why
