"""What several packages' tests share: a small mission with true labels, and the command line."""

import csv
import gc
import os
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

# One process for features: starting a pool takes longer than forty small frames.
os.environ["LOKY_MAX_CPU_COUNT"] = "1"
# The tests themselves run on all cores: more threads of theirs only wait for each other.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ.pop("MLFLOW_TRACKING_URI", None)

import cv2
import numpy as np
import pytest
import typer.main
from _pytest.mark.expression import Expression
from filelock import FileLock
from hypothesis import settings
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tests.calls import call_tokt, run_python, succeeds
from tests.chromium import chromium
from tests.tiers import CORE, TIERS, is_proof, register_profiles, tier_of
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.labels.taxonomy import Taxonomy

# Hundreds of tests call the command line in this process: it is put together once.
typer.main.get_command = cache(typer.main.get_command)

ROOT = Path(__file__).resolve().parents[1]
MISSION = Path(os.environ.get("TOKT_MISSION", ROOT / ".." / "shared" / "mission" / "approach"))
PATCH_HEIGHT, PATCH_WIDTH = 27, 36  # of the default grid on a 360x272 frame
TINY_FRAMES = 40
TINY_BLOCK = 4
LABEL_COLUMNS = ["mission", "camera", "frame", "row", "col", "label"]


def pytest_configure(config: pytest.Config) -> None:
    """One Hypothesis profile a tier; all examples unless the command line wants few."""
    # What is imported and collected stays: to look for garbage in it takes a tenth of all time.
    gc.set_threshold(100_000, 50, 100)
    register_profiles(config.getoption("--hypothesis-profile") or "full")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out what a run of some tiers has no test of: importing it takes longer than most tests.

    A file of the core may hold tests that are marked with another tier, any file tests of the real
    mission.
    """
    chosen = config.option.markexpr
    if not chosen or collection_path.suffix != ".py" or tier_of(collection_path) is CORE:
        return None
    names = {tier_of(collection_path).name, *(["proof"] if is_proof(collection_path) else [])}
    fits = Expression.compile(chosen).evaluate
    return None if fits(names.__contains__) or fits({*names, "mission"}.__contains__) else True


def pytest_collectstart(collector: pytest.Collector) -> None:
    """A module's own settings are made as it is imported: of its tier's profile."""
    if isinstance(collector, pytest.Module):
        settings.load_profile(tier_of(collector.path).name)


@pytest.hookimpl(tryfirst=True)  # before xdist looks for groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark each test with the tier of its folder, unless it is marked with another one.

    Of the tiers whose fixtures take long, one worker runs a file: they are made once.
    """
    for item in items:
        if tier_of(item.path) is not CORE and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
        if not any(item.get_closest_marker(tier.name) for tier in TIERS):
            item.add_marker(tier_of(item.path).name)
        if is_proof(item.path):
            item.add_marker("proof")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say why tests were skipped, one line a reason: `-rs` has one for each place."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count} skipped: {reason}")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """What a test does not set itself comes from its tier's profile too."""
    settings.load_profile(tier_of(item.path).name)


@pytest.fixture(scope="module", autouse=True)
def coarse_figures():
    """Figures are drawn coarsely, which is quick; a file that looks at pixels overrides this."""

    def save(figure: Figure, buffer: BinaryIO, **_: object) -> None:
        figure.set_layout_engine("none")
        figure.set_dpi(20)
        FigureCanvasAgg(figure).print_png(buffer)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Figure, "savefig", save)
        yield


@pytest.fixture(scope="session")
def mission_dir():
    """The real mission's folder."""
    if not (MISSION / "Left").is_dir():
        pytest.skip(f"the real mission is not at {MISSION} (set TOKT_MISSION)")
    return MISSION


@pytest.fixture(scope="session")
def git_files():
    """What git holds of the checkout, or would once all is added; empty without git."""
    git = shutil.which("git")
    if git is None:
        return []
    words = (git, "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    # Links to folders too: those of src/tokt.
    return sorted({name for name in listed.stdout.split("\0") if name and (ROOT / name).exists()})


@pytest.fixture(scope="session")
def sources(git_files, tmp_path_factory):
    """A copy of what git holds: what an older build left behind does not come along."""
    if not git_files:
        return ROOT
    copy = tmp_path_factory.mktemp("copy")
    for name in git_files:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, copy / name, follow_symlinks=False)
    return copy


def tower_cells(frame: int) -> list[tuple[int, int]]:
    """Patches (row, col) that the tower covers in a frame of the tiny mission."""
    if (frame // TINY_BLOCK) % 3 == 0:
        return []
    return [(row, frame % 8 + side) for row in range(3, 7) for side in (0, 1)]


def draw_tiny_frame(frame: int) -> NDArray[np.uint8]:
    """Dark noisy water, 272x360; the tower is coarse texture, and touches the row above it."""
    rng = np.random.default_rng(frame)
    image = rng.normal(20, 2.5, (272, 360)) + np.linspace(-2.5, 2.5, 360)
    for row, col in tower_cells(frame):
        y, x = row * PATCH_HEIGHT, col * PATCH_WIDTH
        coarse = rng.normal(0, 12, (9, 12)).repeat(3, 0).repeat(3, 1)
        image[y : y + PATCH_HEIGHT, x : x + PATCH_WIDTH] += coarse
        if row == 3:
            image[y - 4 : y, x : x + PATCH_WIDTH] += coarse[:4]
    return np.asarray(image.clip(0, 255), np.uint8)


def tiny_label(frame: int, row: int, col: int) -> str:
    """The true label of a patch: the row that the tower only touches is unsure."""
    cells = tower_cells(frame)
    if (row, col) in cells:
        return "subsea_installation"
    return "unsure" if row == 2 and (3, col) in cells else "ocean"


def tiny_labels(name: str = "tiny") -> list[list[Any]]:
    """All rows of the tiny mission's label file."""
    patches = product(range(1, TINY_FRAMES + 1), range(10), range(10))
    return [[name, "left", *patch, tiny_label(*patch)] for patch in patches]


def write_labels(path: Path, rows: Iterable[Iterable[Any]]) -> Path:
    """A label file with these rows."""
    with path.open("w", newline="", encoding="utf-8") as handle:
        csv.writer(handle, lineterminator="\n").writerows([LABEL_COLUMNS, *rows])
    return path


def taxonomy_toml(**obstacle: bool) -> str:
    """A taxonomy file of these classes, each told whether it is an obstacle; keys are 1, 2, ..."""
    classes = [
        f'{{ name = "{name}", obstacle = {str(flag).lower()}, color = "#00000{n}", key = "{n}" }},'
        for n, (name, flag) in enumerate(obstacle.items(), 1)
    ]
    return "\n".join(["format = 1", "classes = [", *classes, "]"])


def write_video(path: Path, images: Iterable[NDArray[np.uint8]]) -> Path:
    """A video of these colour images."""
    first, *others = images
    codec = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), codec, 10.0, first.shape[1::-1])
    assert writer.isOpened()
    for image in (first, *others):
        writer.write(image)
    writer.release()
    return path


@dataclass(frozen=True)
class TinyMission:
    """A mission of 40 left frames and its label file."""

    path: Path
    labels: Path


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory, worker_id):
    """Fill a folder once for all workers: the first that asks fills it, the others wait for it."""
    own = tmp_path_factory.getbasetemp()
    base = own if worker_id == "master" else own.parent

    def fill(name: str, make: Callable[[Path], object]) -> Path:
        folder, made = base / name, base / f"{name}.made"
        with FileLock(base / f"{name}.lock"):
            if not made.exists():
                folder.mkdir()
                make(folder)
                made.touch()
        return folder

    return fill


def build_wheel(sources: Path, folder: Path) -> None:
    """Have pip build the wheel of a folder of sources into another folder."""
    pip = ("-m", "pip", "--disable-pip-version-check", "wheel", "--quiet", "--no-build-isolation")
    done = run_python(*pip, "--no-deps", "--wheel-dir", folder, sources, folder=folder)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="session")
def wheel(sources, shared_folder):
    """tokt as a wheel; `packaging/wheels.py test` names one that is built already."""
    if "TOKT_WHEEL" in os.environ:
        return Path(os.environ["TOKT_WHEEL"])

    return next(shared_folder("wheel", partial(build_wheel, sources)).glob("tokt-*.whl"))


@pytest.fixture(scope="session")
def tiny(shared_folder):
    """The tiny mission; not to be changed."""

    def draw(folder: Path) -> None:
        (folder / "tiny/Left").mkdir(parents=True)
        for frame in range(1, TINY_FRAMES + 1):
            path = folder / f"tiny/Left/tiny_L_{frame}.png"
            cv2.imwrite(str(path), draw_tiny_frame(frame))
        write_labels(folder / "tiny/labels.csv", tiny_labels())

    mission = shared_folder("mission", draw) / "tiny"
    return TinyMission(mission, mission / "labels.csv")


@pytest.fixture
def own_tiny(tiny, tmp_path):
    """A copy of the tiny mission that a test may change."""
    shutil.copytree(tiny.path, tmp_path / "tiny")
    return TinyMission(tmp_path / "tiny", tmp_path / "tiny" / "labels.csv")


@pytest.fixture(scope="session")
def run_tokt():
    """`call_tokt`."""
    return call_tokt


@pytest.fixture(scope="session")
def preload():
    """Python that imports what commands import as they go, for a program that forks them."""
    return """
import alembic.command, git, matplotlib.backends.backend_agg, matplotlib.figure, mlflow.pyfunc
import IPython, PIL.JpegImagePlugin, mlflow.models.display_utils, mlflow.tracing.processor.otel
import tokt.cli.labels, tokt.mlflow
import mlflow.store.model_registry.sqlalchemy_store, mlflow.store.tracking.sqlalchemy_store
import mlflow.store.model_registry.sqlalchemy_workspace_store
import mlflow.store.tracking.sqlalchemy_workspace_store
import pyarrow.dataset, pyarrow.parquet, sqlalchemy.dialects.sqlite
import tokt.labels.store.store, tokt.models.registry.load, tokt.training.evaluation.evaluate
import tokt.training.datasets.mission_source, tokt.training.fitting.tracking
import tokt.training.search.search
from mlflow.utils.requirements_utils import warn_dependency_requirement_mismatches
warn_dependency_requirement_mismatches(["numpy"])  # reads what all installed packages hold, once
"""


BUILD_TINY = ("--block", TINY_BLOCK)
TRAIN_TINY = ("--folds", 3, "--embargo", 1)


@pytest.fixture(scope="session")
def trained(tiny, shared_folder):
    """A workspace with dataset `tiny` and model `tiny-lbp/1` (preset plain); not to be changed."""
    mission = ("--mission", tiny.path, "--labels", tiny.labels)

    def train(folder: Path) -> None:
        where = ("--workspace", folder / ".tokt")
        succeeds("dataset", "build", "tiny", *mission, *BUILD_TINY, *where)
        succeeds("train", "tiny", "--extractor", "lbp", "--preset", "plain", *TRAIN_TINY, *where)

    return shared_folder("workspace", train) / ".tokt"


@pytest.fixture
def workspace(trained, tmp_path):
    """A copy of `trained` that a test may change."""
    shutil.copytree(trained, tmp_path / ".tokt")
    return tmp_path / ".tokt"


@pytest.fixture(scope="session")
def tiny_bundle(trained, tmp_path_factory):
    """`tiny-lbp/1` as a bundle file; not to be changed."""
    path = tmp_path_factory.mktemp("exported") / "tiny-lbp-1.tokt"
    succeeds("export", "tiny-lbp", "-o", path, "--workspace", trained)
    return path


def quiet(items: Iterable[Any], total: int, what: str) -> Iterator[Any]:
    """The progress of functions whose progress is not looked at."""
    yield from items


@pytest.fixture(scope="session")
def no_progress():
    """`quiet`."""
    return quiet


@pytest.fixture(scope="session")
def tiny_truth():
    """The functions that made the tiny mission, for tests that make a variant of it."""
    return SimpleNamespace(
        labels=tiny_labels, write_labels=write_labels, draw=draw_tiny_frame, cells=tower_cells
    )


@pytest.fixture
def fabricate(tmp_path):
    """Build a dataset of 6x6 pixel frames of 1x1 patches from a label and a group for each."""
    import pandas as pd

    from tokt.training.datasets.dataset import DatasetPlan, FrameSource, write_dataset

    def build(labels, groups=None, frames=None, missions=None):
        dives = missions or ["dive"] * len(labels)
        numbers = frames or list(range(len(labels)))
        rng = np.random.default_rng(7)
        images = rng.integers(0, 255, (len(labels), 6, 6), np.uint8)
        files = [(cv2.imencode(".png", image)[1].tobytes(), ".png") for image in images]
        sources = [
            FrameSource(dive, "left", n, group, lambda file=file: file)
            for dive, n, group, file in zip(
                dives, numbers, groups or map(str, numbers), files, strict=True
            )
        ]
        rows = [
            (dive, "left", n, 0, 0, label)
            for dive, n, label in zip(dives, numbers, labels, strict=True)
        ]
        patches = pd.DataFrame(rows, columns=LABEL_COLUMNS)
        about = ("made", "binary", Grid(1, 1, None), Taxonomy.load())
        plan = DatasetPlan(*about, sources, patches, 0, 1, ["made"])
        return write_dataset(plan, tmp_path / "datasets", quiet)

    return build


@pytest.fixture(scope="module")
def browser():
    """Chromium without a window.

    For one module: as long as Playwright's event loop runs in this thread, no other can.
    """
    with ExitStack() as running:
        try:
            started = running.enter_context(chromium(shell=True))
        except ToktError as error:
            pytest.skip(str(error))
        yield started
