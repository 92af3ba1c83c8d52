"""Small valid bundles: random textures, the real extractor, random weights."""

from dataclasses import replace

import numpy as np
import pytest

from tests.models.parts import SEES_ALL, golden_of
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import BundleContent, bundle_bytes, bundle_from_bytes
from tokt.models.linear import LinearModel
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.signing.keys import read_signing_key, write_key_pair
from tokt.models.store.store import Store

TWO = (("ocean", False), ("other", True))


def small_content(seed=0, extractor="lbp", classes=TWO, name="small", channels=()) -> BundleContent:
    """What a bundle of a 2x3 grid on 48x32 frames holds.

    The golden values come from the scaler and the classifier apart, not from the folded model.
    """
    rng = np.random.default_rng(seed)
    grid, parts = Grid(2, 3, 36), extractor_named(extractor)
    frames = [rng.integers(0, 24, (32, 48, *channels), np.uint8) for _ in range(2)]
    frames[0][:, :16] //= 4
    outputs = 1 if len(classes) == 2 else len(classes)
    mean, scale = rng.normal(size=parts.dim), rng.uniform(0.2, 3, parts.dim)
    coef, intercept = rng.normal(size=(outputs, parts.dim)), rng.normal(size=outputs)
    features = [parts.describe(frame, grid) for frame in frames]
    values = np.array([((x - mean) / scale) @ coef.T + intercept for x in features])
    # Half of the patches on either side.
    thresholds = np.median(values, axis=(0, 1)) + 1e-3
    excess = values - thresholds
    chosen = (excess[:, :, 0] > 0).astype(int) if outputs == 1 else excess.argmax(axis=2)
    labels, flags = zip(*classes, strict=True)
    return BundleContent(
        name=name,
        version=str(seed),
        extractor_spec=parts.spec,
        grid=grid,
        model=LinearModel.fold(coef, intercept, mean, scale, thresholds, labels, flags),
        provenance={"mlflow_run_id": "0" * 32, "dataset": f"drawn@{seed}"},
        metrics={"patch": {"f1": 0.5, "recall": None}},
        golden=golden_of(frames, values, np.array(flags)[chosen]),
        trained_on=rng.integers(0, 2**63, 9).astype(np.uint64),
        card=f"# {name}/{seed}\n\nDrawn for a test: bølge.\n",
        operating_point=OperatingPoint(MofNRule(0.0, 2, 1, 3), {"target_rate": 1e-4}),
        sight=(replace(SEES_ALL[0], darkest=0.0),),
    )


@pytest.fixture(scope="session")
def make_content():
    return small_content


@pytest.fixture(scope="session")
def bundles():
    """Three models, ``a/1``, ``b/2`` and ``c/3``."""
    return {
        name: bundle_from_bytes(bundle_bytes(small_content(seed, name=name)), name)
        for seed, name in enumerate("abc", 1)
    }


@pytest.fixture
def store(tmp_path):
    """One that is not there yet."""
    return Store(tmp_path / "ship" / "store")


@pytest.fixture(scope="session")
def key_files(tmp_path_factory):
    """Private key files of ``boat`` and ``other``; the public ones are beside them."""
    folder = tmp_path_factory.mktemp("keys")
    return {name: write_key_pair(folder / name).private_file for name in ("boat", "other")}


@pytest.fixture(scope="session")
def keys(key_files):
    return {name: read_signing_key(file, lambda: "") for name, file in key_files.items()}


@pytest.fixture(scope="session")
def signed(bundles, keys):
    return {name: keys["boat"].sign(bundle, name) for name, bundle in bundles.items()}
