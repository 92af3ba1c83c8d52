"""The training distribution: its distance held against a plain one, and how a bundle carries it."""

import io
import zipfile
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.calls import refuses
from tests.models.parts import pack, rehash, unpack
from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import (
    bundle_bytes,
    bundle_from_bytes,
    distribution_bytes,
    distribution_from_bytes,
)
from tokt.models.distribution import BINS, Distribution, bin_counts, ks_distances, quantile_edges

# Few different values (many patches of one value, as histograms have), or many.
VALUES = st.one_of(
    st.lists(st.integers(-3, 3).map(float), min_size=1, max_size=80),
    st.lists(st.integers(-500, 500).map(lambda n: n / 16), min_size=1, max_size=80),
)


def distribution(dim: int = 12, seed: int = 0) -> Distribution:
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(300, dim))
    edges = np.array([quantile_edges(column) for column in features.T])
    typical = rng.uniform(1 / BINS, 0.2, dim)
    return Distribution(edges, bin_counts(features, edges), typical, 3.5, 20, 90, 4)


def exact_ks(one: list[float], other: list[float]) -> float:
    """Over all values, and just below each."""
    at = np.unique([*one, *other])
    a, b = np.sort(one), np.sort(other)
    shares = [
        np.searchsorted(a, at, side) / len(a) - np.searchsorted(b, at, side) / len(b)
        for side in ("left", "right")
    ]
    return float(np.abs(shares).max())


@settings(max_examples=scaled(150))
@given(trained=VALUES, seen=VALUES)
def test_the_distance_is_the_exact_one_but_for_what_the_bins_resolve(trained, seen):
    edges = quantile_edges(np.array(trained))
    assert (np.diff(edges) >= 0).all()
    one, other = (bin_counts(np.array(each)[:, None], edges[None]) for each in (seen, trained))
    found = ks_distances(one, other)
    exact = exact_ks(trained, seen)
    assert exact - 2 / BINS - 1e-12 <= found[0] <= exact + 1e-12


@settings(max_examples=scaled(60))
@given(seed=st.integers(0, 2**32 - 1), dim=st.integers(1, 9), n=st.integers(1, 30))
def test_bins_are_counted_as_one_feature_at_a_time_would(seed, dim, n):
    rng = np.random.default_rng(seed)
    edges = np.sort(rng.integers(-9, 9, (dim, BINS - 1)), axis=1).astype(float)
    features = rng.integers(-11, 11, (n, dim)).astype(float)
    counts = bin_counts(features, edges)
    for feature in range(dim):
        bins = np.searchsorted(edges[feature], features[:, feature])
        assert counts[feature].tolist() == np.bincount(bins, minlength=BINS).tolist()
    shuffled = rng.permutation(features)
    assert (bin_counts(np.asfortranarray(shuffled), edges) == counts).all()


@pytest.mark.parametrize("moved", [-0.5, -1e-6, 1e-6, 0.5])
def test_leaving_the_one_value_of_training_shows_to_either_side(moved):
    edges = quantile_edges(np.full(50, 7.0))[None]
    trained = bin_counts(np.full((50, 1), 7.0), edges)
    assert ks_distances(bin_counts(np.full((5, 1), 7.0 + moved), edges), trained)[0] == 1
    # What another machine's kernels may make of the same value.
    last_digits = np.array([[7.0 - 1e-12], [7.0], [7.0 + 1e-12]])
    assert ks_distances(bin_counts(last_digits, edges), trained)[0] == 0


def test_a_bundle_carries_it(make_content):
    without = make_content(1)
    content = replace(without, distribution=distribution())
    data = bundle_bytes(content)
    assert data == bundle_bytes(replace(content, distribution=distribution()))
    bundle = bundle_from_bytes(data, "x.tokt")
    found = bundle.distribution
    assert found is not None and found.summary() == distribution().summary()
    for name in ("edges", "counts", "typical", "limits"):
        np.testing.assert_array_equal(getattr(found, name), getattr(distribution(), name))
    assert bundle_bytes(bundle.content) == data
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist()[-2:] == ["distribution.npz", "card.md"]
    assert bundle_from_bytes(bundle_bytes(without), "x.tokt").distribution is None


def changed(**edit: Any) -> bytes:
    """The member with some arrays replaced or (None) left out."""
    with np.load(io.BytesIO(distribution_bytes(distribution()))) as archive:
        arrays = {**archive, **edit}
    buffer = io.BytesIO()
    np.savez(buffer, **{name: array for name, array in arrays.items() if array is not None})
    return buffer.getvalue()


def _with(array: NDArray[Any], at: Any, value: float) -> NDArray[Any]:
    array = array.copy()
    array[at] = value
    return array


GOOD = distribution()
WRONG: list[dict[str, Any]] = [
    {"edges": None},
    {"more": np.zeros(1)},
    {"edges": GOOD.edges.astype(np.float32)},
    {"edges": GOOD.edges[:, :-1]},
    {"edges": GOOD.edges[:, ::-1]},
    {"edges": _with(GOOD.edges, (0, 0), np.nan)},
    {"edges": _with(GOOD.edges, (0, -1), np.inf)},
    {"counts": GOOD.counts.astype(np.int32)},
    {"counts": _with(GOOD.counts, (3, 4), -1)},
    {"counts": _with(GOOD.counts, (3, 4), GOOD.counts[3, 4] + 1)},
    {"counts": GOOD.counts * 0},
    {"typical": GOOD.typical[:, None]},
    {"typical": _with(GOOD.typical, 5, np.nan)},
    {"typical": _with(GOOD.typical, 5, 0.0)},
    {"factor": np.array(0.5)},
    {"factor": np.array(1e9)},
    {"factor": np.array([3.5])},
    {"window_frames": np.array(0)},
    {"window_frames": np.array(10**6)},
    {"stretches": np.array(2)},
    {"stretches": np.array(91)},
    {"windows": np.array(-1)},
]


@pytest.mark.parametrize("edit", WRONG, ids=lambda edit: f"{edit}"[:40])
def test_a_damaged_one_is_refused(make_content, edit):
    refuses(r"^x: distribution\.npz ", distribution_from_bytes, changed(**edit), "x")
    members = unpack(bundle_bytes(replace(make_content(), distribution=GOOD)))
    assert bundle_from_bytes(rehash(members), "x").distribution is not None
    with pytest.raises(ToktError, match=r"^x: distribution\.npz "):
        bundle_from_bytes(rehash({**members, "distribution.npz": changed(**edit)}), "x")


def test_it_must_fit_the_model_and_the_format(make_content):
    other = bundle_bytes(replace(make_content(), distribution=distribution(13)))
    refuses("takes 12 features, its distribution has 13", bundle_from_bytes, other, "x")
    members = unpack(bundle_bytes(replace(make_content(), distribution=GOOD)))
    older = rehash(members, {"format_version": 2, "sight": None, "frame_sizes": None})
    refuses("unknown or missing members", bundle_from_bytes, older, "x")
    with pytest.raises(ToktError, match="has been edited"):
        edited = {**members, "distribution.npz": changed(factor=np.array(3.0))}
        bundle_from_bytes(pack(edited), "x")
