"""Make ``waters``, the model that comes with tokt, from frames whose licence allows it.

``python packaging/make_waters.py SITES``, the folder with the missions of `GROUPS` and their
labels. The same frames, labels and versions of libraries give the same bytes. The bundle has no
picture of them: its golden frames are rendered here, and its dataset holds rows of features.
"""

import json
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import tokt
from tokt.features.common import atomic
from tokt.features.common.arrays import U8
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes
from tokt.models.bundle.card import model_card
from tokt.models.pretrained.packaged import VERSIONS, WATERS, packaged_bundle
from tokt.models.sight import measure_sight
from tokt.training.datasets.changed_patches import changed_patches
from tokt.training.datasets.dataset import PATCH_KEY, write_dataset
from tokt.training.datasets.dataset_options import build_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import BLOCK_FRAMES, EMBARGO_FRAMES, FOLDS
from tokt.training.datasets.split import Split
from tokt.training.fitting.carried import carried_bytes
from tokt.training.fitting.contents import content_of, recipe_of
from tokt.training.fitting.drift_limits import training_distribution
from tokt.training.fitting.plan_of_rows import plan_of_rows
from tokt.training.fitting.presets import (
    DEFAULT_EXTRACTOR,
    extractor_for,
    preset_for,
    settings_named,
)
from tokt.training.fitting.train import (
    TrainRequest,
    fit_and_measure,
    parameters,
    rendered_other_image,
)

FRAMES_A_DIVE = 10
MAX_BYTES = 1_500_000
GROUPS = {
    "basin_a": "basin",
    "basin_b": "basin",
    "basin_c": "basin",
    "basin_d": "basin",
    "basin_e": "basin",
    "gate": "basin",
    "buoys": "basin",
    "pool": "pool",
    "zed": "zed",
    "obsea": "obsea",
    "whip": "whip",
    "net": "net",
    "tank": "aquarium",
    "tankb": "aquarium",
    "foul": "foul",
}
"""The site of each group: those that share a water or a camera are held out together."""
ORIGIN = """## Where it comes from, and what it is not

It learnt from frames that these projects published, and holds none of them:

| group | project | licence |
|---|---|---|
| basin_a to basin_e | beaverauv/robosub_transdec_dataset | MIT |
| gate | enesdemirag/gate-detection | MIT |
| pool | A8neyestani/SUBVO | MIT |
| zed | lukechencqu/bluerov_zed_tracking | Apache-2.0 |
| obsea | obsea-upc/obsea-fish-detector-oscar | MIT |
| buoys | kdglider/buoy_detection | BSD-3-Clause |
| whip | ryan354/ROV-Underwater-Video-analysis | MIT |
| net | Intenzo21, demonstration pictures of Mask R-CNN | Apache-2.0 |
| tank, tankb | Aquarium by Roboflow, in \
shivan2004/underwater-object-detection-and-image-enhancement | CC-BY-4.0 |
| foul | emannix/automating-the-assessment-of-biofouling | Apache-2.0 |

The frames are single pictures of basins, aquariums and a few places in the sea. None is of a \
dive at night or with lamps alone, of a wreck, of ice, or of a gray camera. It is a model to \
begin with: it is unsure on views unlike its waters, which the runtime calls unknown where they \
are far from all that it learnt. Its rate of false statuses on a dive is not known. Sight was \
measured of the cameras that it learnt: open water that another one shows is mostly unknown, \
unless `tokt run --sharp-frames FRAMES` names sharp frames of it. Label a few frames of your own \
dive (`tokt label DIR --model waters`) and let it learn them (`tokt adapt waters --mission DIR`) \
before you rely on it.
"""
_HEIGHT, _WIDTH = 180, 240
_WATER_BGR = (150.0, 120.0, 60.0)


def main(sites: Path) -> None:
    """Train, cross-validate and write the bundle into the package."""
    with tempfile.TemporaryDirectory() as folder:
        data = _bundle(sites, Path(folder))
    if len(data) > MAX_BYTES:
        sys.exit(f"{len(data):,} bytes: more than {MAX_BYTES:,}")
    bundle = bundle_from_bytes(data, WATERS)
    if bundle.deployment_fault or bundle.blindness:
        sys.exit(bundle.deployment_fault or bundle.blindness)
    atomic.write_bytes(packaged_bundle(WATERS), data)
    over = bundle.metrics["over_dives"]
    figures = f"mean F1 {over['f1']:.3f}, AP {over['average_precision']:.3f}"
    print(f"{bundle.label}: {len(data):,} bytes, {bundle.sha256}, {figures}")


def _bundle(sites: Path, workspace: Path) -> bytes:
    pictures = build_dataset(
        name=f"{WATERS}-pictures",
        mission=_listed(sites, workspace),
        # Whole sites are held out: blocks serve only where one dive is left to choose by.
        block=BLOCK_FRAMES,
        workspace=workspace,
    )
    settings = settings_named(preset_for("best", pictures), pictures.grid)
    extractor = extractor_for(DEFAULT_EXTRACTOR, settings.preset, pictures.grid)
    spec, cache = extractor.spec, workspace / "cache"
    (changes,) = settings.changes
    features = cached_features(pictures, spec, cache, _progress, whole_frames=True)
    changed = changed_patches(pictures, spec, changes, cache, _progress)
    plan = plan_of_rows(
        pictures, f"tokt-{WATERS}", extractor, changes, features, changed, FRAMES_A_DIVE
    )
    # It learns from what it carries: so training that goes on from it begins where it ended.
    rows = write_dataset(plan, workspace / "datasets", _progress)
    request = TrainRequest(
        *(rows, WATERS, extractor, DEFAULT_EXTRACTOR, settings),
        Split.of(rows, FOLDS, EMBARGO_FRAMES),
        known_sight=measure_sight(
            map(pictures.read_frame, range(len(pictures.frames))), dives=pictures.frames.mission
        ),
    )
    trained = fit_and_measure(request, cache, _progress)
    # Drift is told by features as they are, not as they were kept.
    known = pictures.patches[PATCH_KEY].reset_index()
    places = rows.patches[PATCH_KEY].merge(known, on=PATCH_KEY)["index"]
    distribution = training_distribution(rows, features[places], EMBARGO_FRAMES)
    trained = replace(trained, distribution=distribution)
    # Neither commit nor run: the same frames give the same bytes.
    version = tokt.__version__.partition(".dev")[0]
    recipe = json.loads(json.dumps(recipe_of(trained, code_version=version)))
    content = content_of(trained, recipe, golden_frames())
    card = model_card(f"{WATERS}/{VERSIONS[WATERS]}", recipe, content.provenance)
    carried = carried_bytes(rows, parameters(trained))
    return bundle_bytes(
        replace(content, version=VERSIONS[WATERS], card=f"{card}\n{ORIGIN}", dataset=carried)
    )


def _listed(sites: Path, workspace: Path) -> Path:
    """Write a list of the missions."""
    tables = [
        {
            "name": dive_name(name),
            "dir": str(sites / name),
            "labels": str(sites / f"{name}_labels.csv"),
            "site": dive_name(site),
        }
        for name, site in GROUPS.items()
    ]
    file = workspace / "missions.toml"
    lines = [
        "\n".join(["[[mission]]", *(f"{key} = {json.dumps(value)}" for key, value in one.items())])
        for one in tables
    ]
    file.write_text("\n".join(lines), "utf-8")
    return file


def dive_name(group: str) -> str:
    """Return the name of a group's dive or site, which no dive of a user's has."""
    return f"{WATERS}.{group}"


def golden_frames() -> list[U8]:
    """Render water that grows darker downwards, and the same with a rough wall in the middle."""
    rng = np.random.default_rng(0)
    light = np.linspace(1.1, 0.7, _HEIGHT)[:, None, None]
    haze = cv2.resize(rng.normal(size=(6, 8)).astype(np.float32), (_WIDTH, _HEIGHT))[..., None]
    water = np.asarray(_WATER_BGR) * light + 3 * haze + rng.normal(size=(_HEIGHT, _WIDTH, 1))
    wall = cv2.resize(rendered_other_image(), (_WIDTH, _HEIGHT), interpolation=cv2.INTER_AREA)
    seen = water.copy()
    rows, cols = slice(_HEIGHT // 4, -_HEIGHT // 4), slice(_WIDTH // 4, -_WIDTH // 4)
    seen[rows, cols] = wall[rows, cols, None] * np.array([0.9, 1.0, 0.8])
    return [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in (water, seen)]


def _progress(items: Iterable[Any], total: int, what: str) -> Iterable[Any]:
    print(f"{what}: {total}", flush=True)
    return items


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
