"""Dives along a pipeline: rendered into a folder with the truth of patches and faults."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.atomic import new_folder
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.inference.stereo.odometry import COLUMNS
from tokt.labels.taxonomy import FILE_NAME, LabelClass, Taxonomy
from tokt.studies.simulation.scene.closed_loop_world import World
from tokt.studies.simulation.scene.pipeline import CLASSES, PIPE, SAND, Pipeline
from tokt.studies.simulation.scene.rig import FULL_WIDTH, SyntheticRig
from tokt.studies.simulation.scene.water import Water

from .patch_labels import MIN_COVERAGE, OCEAN, UNSURE, coverage, labels_csv
from .pipeline_view import FloorHits, FloorMaterials
from .stereo_renderer import StereoRenderer
from .synthetic_mission import JPEG, SCENE_FORMAT, Progress, check_request, render_all, write_image
from .trajectory import rotation, sway

_FRAME_S = 0.5
_ENDS, _FRAMES_A_FAULT = 40, 18
"""Frames of both ends, where nothing is planted, and between one fault and the next."""
_ALTITUDE_M = 1.95
_PITCH_DEG, _UP_DEG = 55.0, -14.0
"""Below the horizon: of the dive, and of its first and last frames, which look into open water."""
_UP_FRAMES, _TILT_FRAMES = 8, 8
_AHEAD_M = 1.3
"""From below the camera to what it looks at."""
_CLEAR_M = 4.0
"""How near a fault must be for a person to name it."""
_FAULT_COVERAGE = 0.25
"""Share of a patch from which a fault counts: on less of it there is no texture to see."""
_HAZE = 2.0
"""Beyond this, over the veil's growth, a person cannot be sure of the floor."""
_TAXONOMY = Taxonomy(
    (
        LabelClass("ocean", False, "#0072b2", "1", "Open water."),
        LabelClass("sand", True, "#f0e442", "2", "Sea floor and stones."),
        LabelClass("pipe", True, "#cc79a7", "3", "A pipeline and its coating."),
        LabelClass("damage", True, "#d55e00", "4", "Broken coating.", "pipe"),
        LabelClass("growth", True, "#009e73", "5", "Marine growth on the pipe.", "pipe"),
        LabelClass("net", True, "#56b4e9", "6", "Nets and other fishing gear.", "pipe"),
    )
)


@dataclass(frozen=True)
class PipelineMission:
    """A rendered dive in numbers."""

    path: str
    name: str
    seed: int
    frames: int
    width: int
    height: int
    length_m: float
    patches: dict[str, int]  # by label
    faults: dict[str, int]  # by class


class _Dive:
    """Everything a seed decides; frames can be rendered from it in any order."""

    def __init__(self, seed: int, n_frames: int, width: int) -> None:
        rig, water, route, track = (np.random.default_rng([seed, 20 + i]) for i in range(4))
        time = (np.arange(n_frames) + 0.5) / n_frames
        steps = (0.275 + 0.01 * sway(track, time)).clip(0.25, 0.30)
        self.seed, self.rig, self.water = seed, SyntheticRig(rig, width), Water.draw(water)
        self.along = np.cumsum(steps) - steps[0]
        length = float(self.along[-1])
        self.pipeline = Pipeline.draw(route, length, max((n_frames - _ENDS) // _FRAMES_A_FAULT, 1))
        self.altitude, self.aside = (
            middle + reach * sway(track, time) for middle, reach in ((_ALTITUDE_M, 0.04), (0, 0.08))
        )
        ends = [0, _UP_FRAMES, _UP_FRAMES + _TILT_FRAMES]
        frame = np.minimum(np.arange(n_frames), np.arange(n_frames)[::-1])
        self.pitch = np.interp(frame, ends, [_UP_DEG, _UP_DEG, _PITCH_DEG]) + sway(track, time)
        self.turn, self.roll = 1.5 * sway(track, time), sway(track, time)
        self.centres, self.rotations = (
            np.stack(each) for each in zip(*map(self._pose, range(n_frames)), strict=True)
        )
        self.velocities = np.gradient(self.centres, _FRAME_S, axis=0)
        world = World(self.water, seed=seed)
        materials = FloorMaterials(self.pipeline.paint)
        self._renderer = StereoRenderer(world, self.rig, seed, materials)

    def _pose(self, i: int) -> tuple[F64, F64]:
        """The left camera's centre, and its rotation from world to camera."""
        point, heading = self.pipeline.axis(float(self.along[i]))
        right = np.array([np.cos(heading), 0.0, -np.sin(heading)])
        centre = np.array([point[0], -self.altitude[i], point[2]]) + self.aside[i] * right
        turn = np.degrees(heading) + self.turn[i]
        return centre, rotation(np.array([self.pitch[i], -turn, self.roll[i]]))

    def render(self, folder: Path, number: int) -> list[str]:
        """Write a stereo pair; return the labels of the left camera's patches."""
        i, labels = number - 1, list[str]()
        cameras = self.rig.cameras(self.rotations[i], self.centres[i])
        for side, (name, letter) in enumerate((("Left", "L"), ("Right", "R"))):
            maps, _ = self._renderer.camera(side)
            along = float(self.along[i]) + _AHEAD_M
            hits = FloorHits(cameras[side], maps.rays, maps.lamp, self.pipeline, along)
            frame = self._renderer.picture(side, i * _FRAME_S, hits, cameras[0], self.velocities[i])
            write_image(folder / name / f"sim_{letter}_{number}.jpg", frame, JPEG)
            labels = labels or self._labels(hits)
        return labels

    def _labels(self, hits: FloorHits) -> list[str]:
        """Labels of patches: of a fault, else of the pipe, where it covers enough and is near."""
        depth, label = hits.depth.reshape(hits.what.shape), hits.what >> 3
        found = np.full(DEFAULT_GRID.n_patches, OCEAN, object)
        for number, name in CLASSES.items():
            mask = np.isfinite(depth) & ((label == number) | (number == SAND))
            limit, share = _CLEAR_M, _FAULT_COVERAGE
            if number in (SAND, PIPE):
                limit, share = _HAZE / self.water.veil_growth, MIN_COVERAGE
            touched = coverage(mask, DEFAULT_GRID)
            if touched.any():
                sure = coverage(mask & (depth < limit), DEFAULT_GRID) >= share
                found[touched > 0] = UNSURE
                found[sure] = name
        return list(found)


def simulate_pipeline(
    out: Path,
    *,
    seed: int = 1,
    n_frames: int = 400,
    width: int = FULL_WIDTH,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> PipelineMission:
    """Render a dive along a pipeline: 400 frames are 110 m with 20 faults, 3 m apart or more.

    Writes ``Left/``, ``Right/``, ``labels.csv``, ``taxonomy.toml``, ``calibration.yml``,
    ``odometry.csv``, ``faults.csv`` and ``scene.json``. A fault's ``along_m`` is the place of its
    centre along the pipe's axis. The first frame is over place 0, and ``scene.json`` has the place
    below the camera of each frame. The folder `out` appears when all of it is written.

    Parameters and errors are those of
    `tokt.studies.simulation.rendering.synthetic_mission.simulate_mission`; 40 frames are the
    fewest.
    """
    out = Path(out)
    if n_frames < _ENDS:
        raise ToktError(f"a dive along a pipeline has at least {_ENDS} frames, not {n_frames}")
    check_request(out, seed, n_frames, width, jobs)
    dive, name = _Dive(seed, n_frames, width), out.resolve().name
    with new_folder(out) as folder:
        for part in ("Left", "Right"):
            (folder / part).mkdir()
        labels = render_all(lambda number: dive.render(folder, number), n_frames, jobs, progress)
        text = labels_csv(name, enumerate(labels, 1), DEFAULT_GRID)
        (folder / "labels.csv").write_bytes(text)
        (folder / FILE_NAME).write_text(_TAXONOMY.to_toml(), encoding="utf-8")
        dive.rig.write(folder / "calibration.yml")
        _write_csv(folder / "odometry.csv", COLUMNS, _odometry(dive))
        faults = ("class", "along_m", "length_m", "x_m", "y_m", "z_m")
        _write_csv(folder / "faults.csv", faults, _faults(dive))
        (folder / "scene.json").write_text(_scene_json(dive), encoding="utf-8")
    return PipelineMission(
        path=str(out),
        name=name,
        seed=seed,
        frames=n_frames,
        width=dive.rig.width,
        height=dive.rig.height,
        length_m=round(float(dive.along[-1]), 2),
        patches=dict(Counter(label for frame in labels for label in frame)),
        faults=dict(Counter(CLASSES[fault.kind] for fault in dive.pipeline.faults)),
    )


def _write_csv(path: Path, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([columns, *rows])
    path.write_text(text.getvalue(), encoding="utf-8")


def _odometry(dive: _Dive) -> Iterable[list[Any]]:
    """The left camera's poses, of camera's axes in the world's."""
    for i, (centre, turn) in enumerate(zip(dive.centres, dive.rotations, strict=True)):
        axis = cv2.Rodrigues(turn.T)[0].ravel()
        angle = float(np.linalg.norm(axis))
        quaternion = [np.cos(angle / 2), *(np.sinc(angle / 2 / np.pi) / 2 * axis)]
        yield [i + 1, i * _FRAME_S, *(f"{value:.6f}" for value in (*centre, *quaternion))]


def _faults(dive: _Dive) -> Iterable[list[Any]]:
    for fault in dive.pipeline.faults:
        place = (fault.along_m, fault.length_m, *dive.pipeline.place(fault))
        yield [CLASSES[fault.kind], *(f"{value:.3f}" for value in place)]


def _scene_json(dive: _Dive) -> str:
    told = {"along_m": dive.along, "altitude_m": dive.altitude, "pitch_deg": dive.pitch}
    frames = [
        {"frame": i + 1, **{key: round(float(values[i]), 4) for key, values in told.items()}}
        for i in range(len(dive.along))
    ]
    content = {
        "format": SCENE_FORMAT,
        "seed": dive.seed,
        "width": dive.rig.width,
        "height": dive.rig.height,
        "grid": str(DEFAULT_GRID),
        "least_coverage": MIN_COVERAGE,
        "radius_m": round(dive.pipeline.radius_m, 4),
        "axis_over_floor_m": round(dive.pipeline.lift_m, 4),
        "water": asdict(dive.water),
        "frames": frames,
    }
    return json.dumps(content, indent=1) + "\n"
