"""The presets on the real mission: what they reach, and that `thesis` is the thesis's method."""

import json

import numpy as np
import pandas as pd
import pytest

from tests.calls import succeeds
from tests.inference.attacks import ATTACKS
from tokt.features.frames.mission import open_mission
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN
from tokt.models.registry.registry import Registry
from tokt.training.evaluation.evaluate import first_detection

# The thesis trains on two images: of the dataset only the figures depend, not the model.
FEW = "80-85,100-105,140-145,160-165,180-185,200-205"
# Each frame around the first sight of the tower, every eighth elsewhere.
CURVE_FRAMES = [*range(3, 131, 8), *range(131, 176), *range(179, 247, 8)]

pytestmark = pytest.mark.mission


@pytest.fixture(scope="module")
def workspace(mission_dir, tmp_path_factory):
    """A workspace with the mission's dataset."""
    folder = tmp_path_factory.mktemp("real") / ".tokt"
    where = ("--labels", mission_dir / "labels.csv", "--workspace", folder)
    for name, *some in (("approach",), ("few", "--frames", FEW)):
        succeeds("dataset", "build", name, "--mission", mission_dir, *some, *where)
    return folder


@pytest.fixture
def train(workspace):
    def run(dataset, *arguments):
        command = ("train", dataset, "--json", "--workspace", workspace)
        return json.loads(succeeds(*command, *arguments).out)

    return run


def test_best_reaches_in_blocked_cross_validation(train, workspace):
    """Without the changed pictures, which take three times as long; with them it is the same."""
    result = train("approach", "--changes", "none")
    cv, frames = result["cv"], result["cv"]["frames"]
    assert cv["patch"]["f1"] >= 0.95  # measured: 0.954
    assert cv["converged"]
    assert cv["patches_tested"] == 20841
    # By each fold's rule, chosen for 1 false status in 10,000 frames on its training part.
    assert (frames["ocean_frames"], frames["false_status"]) == (99, 0)
    assert frames["obstacle_frames"] == 107 and frames["detected"] >= 90  # measured: 94
    # The tower is labelled from 140 on, and a patch of it must be seen in 3 of 5 frames.
    assert frames["first_detection"]["approach"] <= 142
    assert cv["frames_at_zero"]["false_status"] > 0  # what the rule is for
    chosen = result["operating_point"]["chosen"]
    assert (chosen["ocean_frames"], chosen["ocean_blocks"]) == (99, 5)
    assert chosen["reachable"] is False and chosen["false_status"] == 0
    # Exporting checks that the folded weights agree with scikit-learn's to 1e-9 on real frames.
    assert Registry(workspace).bundle("approach-haralick").content.metrics == cv


def statuses(bundle, pictures, attack=lambda picture: picture):
    """Status of each frame, by its number."""
    policy = SinglePolicy(TextureDetector(bundle))
    return {
        number: policy.judge(Frame(number, 0.0, attack(picture), None)).verdict.status
        for number, picture in pictures.items()
    }


def test_no_attack_on_a_picture_makes_the_tower_clear(workspace, mission_dir):
    """A model of half of the blocks, so that half of the frames are none it learnt from."""
    half = ",".join(f"{first}-{first + 11}" for first in range(1, 247, 24))
    where = ("--labels", mission_dir / "labels.csv", "--workspace", workspace)
    succeeds("dataset", "build", "half", "--mission", mission_dir, "--frames", half, *where)
    succeeds("train", "half", "--folds", 2, "--changes", "none", "--workspace", workspace)
    bundle, mission = Registry(workspace).bundle("half-haralick"), open_mission(mission_dir)
    # Every second frame of the approach; attacks on all that decide about one that is seen.
    pictures = {number: mission.read(number) for number in range(125, 247, 2)}
    plain = statuses(bundle, pictures)
    seen = [number for number, status in plain.items() if status == OBSTACLE]
    assert len(seen) >= 45 and UNKNOWN not in plain.values()
    first = seen[0] - 2 * (TextureDetector(bundle).window_frames - 1)
    pictures = {n: picture for n, picture in pictures.items() if first <= n <= seen[-1]}
    for name, attack in ATTACKS.items():
        said = statuses(bundle, pictures, attack)
        assert [number for number in seen if said[number] == CLEAR] == [], name


def test_preset_thesis_follows_the_thesiss_curve(train, workspace, mission_dir):
    """The curve comes from a film still that is not here, so shapes are compared, not values."""
    ocean = mission_dir.parent / "ocean_tokt1_R_1037.jpg"
    curves = mission_dir.parent / "thesis_port_curves.csv"
    if not ocean.is_file() or not curves.is_file():
        pytest.skip(f"{ocean.name} or {curves.name} is not beside the real mission")
    columns = {"lbp10": "lbp_10_5", "har": "haralick"}
    for column, extractor in columns.items():
        arguments = ("--extractor", extractor, "--preset", "thesis", "--name", f"thesis-{column}")
        train("few", *arguments, "--folds", 2, "--ocean", ocean)
    bundles = [Registry(workspace).bundle(f"thesis-{column}") for column in columns]
    counts = []
    for picture in map(open_mission(mission_dir).read, CURVE_FRAMES):
        values = [bundle.decision_values(picture) for bundle in bundles]
        judged = zip(bundles, values, strict=True)
        counts.append([bundle.model.obstacle_patches(one).sum() for bundle, one in judged])
    for column, found in zip(columns, np.transpose(counts), strict=True):
        theirs = pd.read_csv(curves, index_col="# frame")[column]
        status = (found > 0).astype(int).tolist()
        assert np.corrcoef(found, theirs[CURVE_FRAMES])[0, 1] > 0.95, column
        assert max(status[: CURVE_FRAMES.index(131)]) == 0
        seen = first_detection(CURVE_FRAMES, [0] * len(CURVE_FRAMES), status)
        assert 145 <= (seen or 0) <= 170
