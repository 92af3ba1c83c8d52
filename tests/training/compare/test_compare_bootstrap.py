"""The paired block bootstrap: it must see a real difference and not see one that is luck."""

from __future__ import annotations

import numpy as np
from sklearn.metrics import f1_score

from tokt.training.compare.bootstrap import compare_f1


def _patches(seed: int, n_blocks: int = 12, each: int = 200):
    rng = np.random.default_rng(seed)
    truth = rng.random(n_blocks * each) < 0.3
    groups = np.repeat([f"m#{block:05d}" for block in range(n_blocks)], each)
    return rng, truth, groups


def test_the_figures_are_scikit_learns() -> None:
    rng, truth, groups = _patches(1)
    first, second = truth ^ (rng.random(truth.size) < 0.1), truth ^ (rng.random(truth.size) < 0.2)
    found = compare_f1(truth, first, second, groups)
    assert np.isclose(found.f1_first, f1_score(truth, first))
    assert np.isclose(found.f1_second, f1_score(truth, second))
    assert found.verdict == "better" and found.low > 0 and found.blocks == 12
    turned = compare_f1(truth, second, first, groups)
    assert turned.verdict == "worse"
    assert np.isclose(turned.low, -found.high) and np.isclose(turned.high, -found.low)


def test_a_model_does_not_differ_from_itself() -> None:
    _, truth, groups = _patches(2)
    found = compare_f1(truth, ~truth, ~truth, groups)
    assert (found.difference, found.low, found.high) == (0, 0, 0)
    assert found.verdict == "cannot tell"


def test_one_lucky_block_of_many_is_no_difference() -> None:
    """Hundreds of patches differ, but all in one block: whole blocks are what is independent."""
    _, truth, groups = _patches(3)
    first = truth.copy()
    second = np.where(groups == groups[0], ~truth, truth)
    assert compare_f1(truth, first, second, groups).verdict == "cannot tell"


def test_equal_models_are_seldom_called_different() -> None:
    wrong = 0
    for seed in range(40):
        rng, truth, groups = _patches(100 + seed)
        said = [truth ^ (rng.random(truth.size) < 0.15) for _ in range(2)]
        wrong += compare_f1(truth, said[0], said[1], groups).verdict != "cannot tell"
    assert wrong <= 8, "a 95 % interval over 12 blocks should miss 0 in about one of 15 cases"
