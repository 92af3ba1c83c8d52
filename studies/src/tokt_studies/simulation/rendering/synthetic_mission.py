"""Synthetic missions: one approach to a tower, rendered into a folder with its truth."""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import U8
from tokt.features.common.atomic import new_folder
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt_studies.simulation.scene.rig import FULL_WIDTH, SyntheticRig
from tokt_studies.simulation.scene.tower import Tower
from tokt_studies.simulation.scene.water import Water

from . import patch_labels as labelling
from .lighting import Exposure, expose
from .raycast import View
from .sensor import develop
from .trajectory import CameraPose, draw_trajectory

SCENE_FORMAT = 1
"""Version of scene.json; a change of meaning or a key taken away raises it."""
_MIN_WIDTH = 120
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 95,
         cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422]  # fmt: skip
"""Quantisation and colour sampling of the mission's own files."""
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 3]
_MOMENT, _SENSOR = 4, 5
"""Numbers of the random streams of a frame; the scene's are 0 to 3."""
_CAMERAS = (("Left", "L"), ("Right", "R"))
_FARTHEST_MM = np.iinfo(np.uint16).max

Progress = Callable[[Iterable["RenderedFrame"], int, str], Iterable["RenderedFrame"]]


@dataclass(frozen=True)
class RenderedFrame:
    """One rendered stereo pair's part of the labels and the scene file."""

    number: int
    nearest_m: float | None
    place: dict[str, float]  # more of what the scene file says of it
    labels: list[str]


@dataclass(frozen=True)
class SyntheticMission:
    """A rendered mission in numbers."""

    path: str
    name: str
    seed: int
    frames: int
    width: int
    height: int
    obstacle_frames: int  # with a patch labelled as an obstacle
    ocean_frames: int  # without any pixel of one
    patches: dict[str, int]  # by label
    nearest_m: float | None  # least depth of an obstacle in the left camera


@dataclass(frozen=True, eq=False)
class Scene(ABC):
    """Everything a seed decides; frames can be rendered from it in any order."""

    seed: int
    rig: SyntheticRig
    water: Water
    classes: ClassVar[tuple[str, ...]]
    label_limits: ClassVar[dict[str, float]]  # what decides a patch's label

    @abstractmethod
    def write(self, folder: Path) -> None:
        """Write what is not of one frame; make the folders of what is."""

    @abstractmethod
    def render(self, folder: Path, number: int) -> RenderedFrame:
        """Render and write one stereo pair, and the left camera's truth."""


@dataclass(frozen=True, eq=False)
class MissionScene(Scene):
    """An approach to a tower."""

    classes = (labelling.OCEAN, labelling.TOWER)
    label_limits: ClassVar = {
        "least_coverage": labelling.MIN_COVERAGE,
        "least_contrast_grey_levels": labelling.MIN_CONTRAST,
    }
    tower: Tower
    poses: list[CameraPose]

    @classmethod
    def draw(cls, seed: int, n_frames: int, width: int) -> MissionScene:
        """Draw a scene; each part has a stream of its own, so that none shifts another."""
        rig, water, tower, trajectory = (np.random.default_rng([seed, part]) for part in range(4))
        poses = draw_trajectory(trajectory, n_frames)
        return cls(seed, SyntheticRig(rig, width), Water.draw(water), Tower.draw(tower), poses)

    def write(self, folder: Path) -> None:
        """See `Scene`."""
        for part in ("masks", "depth"):
            (folder / part).mkdir()

    def render(self, folder: Path, number: int) -> RenderedFrame:
        """See `Scene`."""
        pose = self.poses[number - 1]
        views = [View(camera, self.tower) for camera in pose.cameras(self.rig)]
        responses = (self.water.left, self.water.right)
        for side, (view, response) in enumerate(zip(views, responses, strict=True)):
            moment = np.random.default_rng([self.seed, _MOMENT, number])
            exposure = expose(self.water, pose, view, response, moment)
            if side == 0:
                labels = _write_truth(folder, number, view, exposure)
            sensor = np.random.default_rng([self.seed, _SENSOR, number, side])
            write_picture(folder, side, number, develop(self.water, exposure, sensor))
        place = {"to_collar_m": round(float(np.linalg.norm(pose.centre)), 4)}
        return RenderedFrame(number, nearest_m(views[0].depth), place, labels)


def simulate_mission(
    out: Path,
    *,
    seed: int = 1,
    n_frames: int = 120,
    width: int = FULL_WIDTH,
    jobs: int | None = None,
    progress: Progress | None = None,
    draw: Callable[[int, int, int], Scene] = MissionScene.draw,
) -> SyntheticMission:
    """Render a mission: open water, an approach to a tower, a retreat.

    Writes ``Left/sim_L_N.jpg``, ``Right/sim_R_N.jpg``, ``masks/L_N.png`` (255 on the tower),
    ``depth/L_N.png`` (16 bit, mm along the optical axis, 0 is open water), ``labels.csv``,
    ``calibration.yml`` and ``scene.json``. The folder `out` appears when all of it is written; its
    name becomes the mission's name.

    The same seed gives the same bytes, whatever the `jobs` (threads; by default one a core). From
    40 frames on every part of the dive has some. The height and the cameras follow the mission's
    proportions. ``progress(frames, total, what)`` passes the frames on as they are done, and
    ``draw(seed, n_frames, width)`` gives another scene, which may write other truth. Raises
    ToktError if `out` is there and not an empty folder, or a number is out of range.
    """
    out = Path(out)
    _check(out, seed, n_frames, width, jobs)
    scene = draw(seed, n_frames, width)
    name = out.resolve().name
    if out.is_dir():
        out.rmdir()
    with new_folder(out) as folder:
        for part, _ in _CAMERAS:
            (folder / part).mkdir()
        scene.write(folder)
        frames = _render_all(scene, folder, n_frames, jobs or os.cpu_count() or 1, progress)
        labels = labelling.labels_csv(name, ((one.number, one.labels) for one in frames))
        (folder / "labels.csv").write_bytes(labels)
        scene.rig.write(folder / "calibration.yml")
        (folder / "scene.json").write_text(_scene_json(scene, frames), encoding="utf-8")
    return _summary(out, scene, frames)


def _check(out: Path, seed: int, n_frames: int, width: int, jobs: int | None) -> None:
    if out.is_dir() and any(out.iterdir()):
        raise ToktError(f"{out} is not empty; give the name of a new folder")
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is a file; give the name of a new folder")
    if seed < 0:
        raise ToktError(f"a seed is 0 or more, not {seed}")
    if n_frames < 1:
        raise ToktError(f"a mission has at least one frame, not {n_frames}")
    check_width(width)
    if jobs is not None and jobs < 1:
        raise ToktError(f"at least one job is needed, not {jobs}")


def check_width(width: int) -> None:
    """Refuse a frame width in pixels that nothing can be rendered in."""
    if not _MIN_WIDTH <= width <= FULL_WIDTH:
        raise ToktError(f"frames are {_MIN_WIDTH} to {FULL_WIDTH} pixels wide, not {width}")


def _render_all(
    scene: Scene, folder: Path, total: int, jobs: int, progress: Progress | None
) -> list[RenderedFrame]:
    with ThreadPoolExecutor(jobs) as pool:
        try:
            done: Iterable[RenderedFrame] = pool.map(
                lambda number: scene.render(folder, number), range(1, total + 1)
            )
            if progress is not None:
                done = progress(done, total, "simulate")
            return list(done)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _write_truth(folder: Path, number: int, view: View, exposure: Exposure) -> list[str]:
    """Write mask and depth of the left camera; return the labels of its patches."""
    depth = view.image(view.depth)
    mask = np.isfinite(depth)
    millimetres = np.where(mask, np.rint(depth * 1000), 0).clip(0, _FARTHEST_MM)
    _write_image(folder / "masks" / f"L_{number}.png", mask.astype(np.uint8) * 255, _PNG)
    _write_image(folder / "depth" / f"L_{number}.png", millimetres.astype(np.uint16), _PNG)
    covered = labelling.coverage(mask, DEFAULT_GRID)
    if not mask.any():
        return labelling.patch_labels(covered, covered)
    return labelling.patch_labels(
        covered, labelling.contrast(exposure.clean, exposure.open_water, mask, DEFAULT_GRID)
    )


def nearest_m(depth: NDArray[Any]) -> float | None:
    """The least depth in metres; None where all is open water."""
    nearest = float(depth.min())
    return round(nearest, 4) if np.isfinite(nearest) else None


def write_picture(folder: Path, side: int, number: int, image: U8) -> None:
    """Write a frame of the left camera (0) or the right one (1)."""
    name, letter = _CAMERAS[side]
    _write_image(folder / name / f"sim_{letter}_{number}.jpg", image, JPEG)


def _write_image(path: Path, image: NDArray[Any], parameters: list[int]) -> None:
    good, data = cv2.imencode(path.suffix, image, parameters)
    if not good:
        raise RuntimeError(f"OpenCV cannot encode {path.name}")
    path.write_bytes(data.tobytes())


def _scene_json(scene: Scene, frames: list[RenderedFrame]) -> str:
    content = {
        "format": SCENE_FORMAT,
        "seed": scene.seed,
        "n_frames": len(frames),
        "width": scene.rig.width,
        "height": scene.rig.height,
        "grid": str(DEFAULT_GRID),
        **scene.label_limits,
        "water": asdict(scene.water),
        "frames": [
            {"frame": frame.number, "nearest_m": frame.nearest_m, **frame.place} for frame in frames
        ],
    }
    return json.dumps(content, indent=1) + "\n"


def _summary(out: Path, scene: Scene, frames: list[RenderedFrame]) -> SyntheticMission:
    labels = Counter(label for frame in frames for label in frame.labels)
    return SyntheticMission(
        path=str(out),
        name=out.resolve().name,
        seed=scene.seed,
        frames=len(frames),
        width=scene.rig.width,
        height=scene.rig.height,
        obstacle_frames=sum(
            bool({*frame.labels} - {labelling.OCEAN, labelling.UNSURE}) for frame in frames
        ),
        ocean_frames=sum(frame.nearest_m is None for frame in frames),
        patches={label: labels[label] for label in (*scene.classes, labelling.UNSURE)},
        nearest_m=min((f.nearest_m for f in frames if f.nearest_m is not None), default=None),
    )
