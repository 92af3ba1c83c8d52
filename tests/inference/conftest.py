"""Small missions, a small real model and real sockets for the runtime's tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.inference.live import bound_socket
from tests.inference.still_water import begin_anew
from tests.models.parts import SEES_ALL, golden_of
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import Grid
from tokt.features.kernels.quantization import Quantization
from tokt.models.bundle.bundle import BundleContent, Golden, bundle_bytes
from tokt.models.distribution import Distribution, bin_counts, quantile_edges
from tokt.models.linear import LinearModel
from tokt.models.operating_point import OperatingPoint
from tokt.models.sight import SightLimits, measure_sight

PATCH_HEIGHT, PATCH_WIDTH = 27, 36  # of the default grid on a 360x271 frame


@pytest.fixture(scope="session")
def mission(mission_dir):
    return mission_dir


@pytest.fixture(scope="session")
def calibration_path(mission):
    path = mission.parent / "calibration.yml"
    if not path.is_file():
        pytest.skip(f"the real mission's calibration is not at {path}")
    return path


def draw(patches: list[tuple[int, int]], seed: int = 0) -> NDArray[np.uint8]:
    """A 360x271 gray frame: two striped halves, and strong noise on the given (row, col) patches.

    No patch is of one grey level, or equal in two frames of other seeds, which no camera gives
    either. What is drawn is whole JPEG blocks, so that it survives compression as it is.
    """
    frame = np.full((271, 360), 30, np.uint8)
    frame[:, 180:] = 45
    frame[np.arange(271) // 8 % 3 == 0] += 4
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, 4, (34, 45)) == 0
    frame += blocks.repeat(8, axis=0).repeat(8, axis=1)[:271]
    for row, col in patches:
        y, x = row * PATCH_HEIGHT, col * PATCH_WIDTH
        noise = rng.integers(10, 120, (PATCH_HEIGHT, PATCH_WIDTH))
        frame[y : y + PATCH_HEIGHT, x : x + PATCH_WIDTH] = noise
    return frame


@lru_cache
def sight_of_drawn() -> tuple[SightLimits, ...]:
    """What drawn frames show, the emptiest of them too."""
    return measure_sight(draw([], seed) for seed in range(30))


@pytest.fixture(scope="session")
def draw_frame():
    return draw


def write_mission(folder: Path, scenes: Sequence[list[tuple[int, int]]]) -> Path:
    """Write a stereo folder: for each frame the patches with noise."""
    for camera, letter in (("Left", "L"), ("Right", "R")):
        (folder / camera).mkdir(parents=True, exist_ok=True)
        for number, patches in enumerate(scenes, 1):
            path = folder / camera / f"t_{letter}_{number}.jpg"
            cv2.imwrite(str(path), draw(patches, number), [cv2.IMWRITE_JPEG_QUALITY, 98])
    return folder


@pytest.fixture(autouse=True)
def same_water():
    """The same pictures of still water whichever tests ran before."""
    begin_anew()


@pytest.fixture
def make_mission(tmp_path):
    """`write_mission` in the test's own folder."""
    return lambda scenes, name="dive": write_mission(tmp_path / name, scenes)


@dataclass
class NoiseScorer:
    """A patch scorer without any learning: a patch's standard deviation less 5 grey levels."""

    label: str = "noise/1"
    grid: Grid = Grid()  # noqa: RUF009 - frozen
    frame_sizes: tuple[tuple[int, int], ...] = ((271, 360),)
    images: tuple[Quantization | None, ...] = (None,)
    needs_colour: bool = False
    named_classes: tuple[str, ...] = ()
    operating_point: OperatingPoint = OperatingPoint()  # noqa: RUF009 - frozen
    distribution: Distribution | None = None
    golden: Golden | None = None
    sight: tuple[SightLimits, ...] = SEES_ALL

    @property
    def model(self) -> NoiseScorer:
        return self

    def features(self, frame, pictures=None, threads=1) -> NDArray[np.float64]:
        height, width = self.grid.resized(*frame.shape[:2])
        gray = frame if frame.ndim == 2 else frame.mean(axis=2).astype(np.uint8)
        cells = self.grid.cells(np.asarray(cv2.resize(gray, (width, height))))
        return np.asarray(cells.std(axis=(1, 2))[:, None])

    def values_of(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        return features - 5.0

    def decision_values(self, frame: NDArray[np.uint8]) -> NDArray[np.float64]:
        return self.values_of(self.features(frame))

    def obstacle_score(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values[:, 0]

    def obstacle_patches(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        return values[:, 0] > 0


class LevelScorer(NoiseScorer):
    """The same with the patches' grey levels beside it, and what they were in the frames learnt."""

    def __init__(self, learnt: Sequence[Any], typical: float = 0.1) -> None:
        super().__init__()
        rows = np.vstack([self.features(picture) for picture in learnt])
        edges = np.array([quantile_edges(column) for column in rows.T])
        counts, distances = bin_counts(rows, edges), np.full(len(edges), typical)
        self.distribution = Distribution(edges, counts, distances, 3.5, 20, 9, 4)
        self.golden = golden_of(learnt[:2], [], [])

    def features(self, frame, pictures=None, threads=1) -> NDArray[np.float64]:
        cells = self.grid.cells(frame)
        levels = cells.mean(axis=(1, 2)), cells.min(axis=(1, 2))
        return np.column_stack([super().features(frame), *levels])


@pytest.fixture
def noise_scorer():
    return NoiseScorer()


@pytest.fixture(scope="session")
def bundle_file(tmp_path_factory):
    """A real bundle: noise has few pixels whose whole neighbourhood is as bright or brighter."""
    extractor, grid = extractor_named("lbp_10_5_frame"), Grid()
    weights = np.zeros((1, extractor.dim))
    weights[0, 10] = -1.0
    model = LinearModel(weights, np.array([0.2]), np.zeros(1), ("ocean", "other"), (False, True))
    frame = draw([(4, 5)])
    values = model.decision_values(extractor.describe(frame, grid))
    golden = golden_of([frame], [values], [model.obstacle_patches(values)])
    content = BundleContent(
        *("noise", "7", extractor.spec, grid, model),
        provenance={},
        metrics={},
        golden=golden,
        trained_on=np.zeros(0, np.uint64),
        card="A model for tests.\n",
        sight=SEES_ALL,
    )
    path = tmp_path_factory.mktemp("bundle") / "noise-7.tokt"
    path.write_bytes(bundle_bytes(content))
    return path


@pytest.fixture
def receiver():
    """A UDP socket on a loopback port of its own."""
    with bound_socket() as opened:
        yield opened


@pytest.fixture
def closed_port():
    """A loopback port that nobody listens on."""
    with bound_socket() as opened:
        return int(opened.getsockname()[1])


class HandClock:
    """A clock that moves only when somebody sleeps, or when a test moves it; for any thread."""

    def __init__(self) -> None:
        self.now = 100.0
        self.suspended_s = 0.0
        self.slept: list[float] = []

    def time(self) -> float:
        return 1_000_000.0 + self.now

    def monotonic(self) -> float:
        return self.now

    def suspended(self) -> float:
        return self.suspended_s

    def suspend(self, seconds: float) -> None:
        self.suspended_s += seconds
        self.now += seconds

    def sleep(self, seconds: float, /) -> None:
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def hand_clock():
    return HandClock()
