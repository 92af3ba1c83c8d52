"""A dive along a pipeline: its frames, the labels of their patches, the track and the faults."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
import pandas as pd

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.inference.stereo.odometry import COLUMNS
from tokt.labels.taxonomy import FILE_NAME, LabelClass, Taxonomy
from tokt_studies.simulation.scene.closed_loop_world import World
from tokt_studies.simulation.scene.pipeline import CLASSES, PIPE, Pipeline
from tokt_studies.simulation.scene.rig import SyntheticRig
from tokt_studies.simulation.scene.water import Water

from .patch_labels import MIN_COVERAGE, OCEAN, UNSURE, coverage
from .pipeline_view import FloorHits, FloorMaterials
from .stereo_renderer import StereoRenderer
from .synthetic_mission import RenderedFrame, Scene, nearest_m, write_picture
from .trajectory import CameraPose, rotation, sway

_FRAME_S = 0.5
_ENDS, _FRAMES_A_FAULT = 40, 18
"""Frames of both ends, where nothing is planted, and between one fault and the next."""
_TILTED, _PITCH_DEG = [0, 8, 16], [-14.0, -14.0, 55.0]
"""Frames from either end, and how far down the camera looks: first and last into open water."""
_ALTITUDE_M, _AHEAD_M = 1.95, 1.3
"""Above the floor; from there to what it looks at."""
_CLEAR_M, _HAZE = 4.0, 2.0
"""Within it a person can name a fault; within this, over the veil's growth, see the floor."""
_FAULT_COVERAGE = 0.25
"""Share of a patch from which a fault counts: on less of it there is no texture to see."""
_TAXONOMY = Taxonomy(
    (
        LabelClass(OCEAN, False, "#0072b2", "1", "Open water."),
        LabelClass("sand", True, "#f0e442", "2", "Sea floor and stones."),
        LabelClass("pipe", True, "#cc79a7", "3", "A pipeline and its coating."),
        LabelClass("damage", True, "#d55e00", "4", "Broken coating.", "pipe"),
        LabelClass("growth", True, "#009e73", "5", "Marine growth on the pipe.", "pipe"),
        LabelClass("net", True, "#56b4e9", "6", "Nets and other fishing gear.", "pipe"),
    )
)


@dataclass(frozen=True, eq=False)
class PipelineScene(Scene):
    """A pipeline, and a vehicle that follows it: 400 frames are 110 m and 20 faults.

    Beside the pictures it writes ``taxonomy.toml``, ``odometry.csv`` and ``faults.csv``. A fault's
    ``along_m`` is the place of its centre along the pipe's axis; ``scene.json`` has for each frame
    that of the point below the camera, from 0 on.
    """

    classes = _TAXONOMY.names
    label_limits: ClassVar = {
        "least_coverage": MIN_COVERAGE,
        "least_fault_coverage": _FAULT_COVERAGE,
        "farthest_fault_m": _CLEAR_M,
        "farthest_floor_by_veil_growth": _HAZE,
    }
    pipeline: Pipeline
    along: F64  # (frames,) place along the axis, m
    poses: list[CameraPose]
    renderer: StereoRenderer

    @classmethod
    def draw(cls, seed: int, n_frames: int, width: int) -> PipelineScene:
        """Draw a scene; refuse too short a dive."""
        if n_frames < _ENDS:
            raise ToktError(f"a dive along a pipeline has at least {_ENDS} frames, not {n_frames}")
        rig, water, route, track = (np.random.default_rng([seed, 20 + part]) for part in range(4))
        time = (np.arange(n_frames) + 0.5) / n_frames
        steps, rise, aside, pitch, turn, roll = (sway(track, time) for _ in range(6))
        along = np.cumsum((0.275 + 0.01 * steps).clip(0.25, 0.30))
        along -= along[0]
        n_faults = max((n_frames - _ENDS) // _FRAMES_A_FAULT, 1)
        pipeline = Pipeline(route, float(along[-1]), n_faults)
        axis, heading = pipeline.axis(along)
        centres = axis + 0.08 * aside[:, None] * pipeline.right(heading)
        centres[:, 1] = -_ALTITUDE_M - 0.04 * rise
        frame = np.arange(n_frames)
        pitch += np.interp(np.minimum(frame, frame[::-1]), _TILTED, _PITCH_DEG)
        turns = np.stack([pitch, -np.degrees(heading) - 1.5 * turn, roll], axis=1)
        poses = [
            CameraPose(*pose)
            for pose in zip(
                centres, map(rotation, turns), np.gradient(centres, _FRAME_S, axis=0), strict=True
            )
        ]
        cameras, conditions = SyntheticRig(rig, width), Water.draw(water)
        world, materials = World(conditions, seed=seed), FloorMaterials(pipeline.paint)
        renderer = StereoRenderer(world, cameras, seed, materials)
        return cls(seed, cameras, conditions, pipeline, along, poses, renderer)

    def render(self, folder: Path, number: int) -> RenderedFrame:
        """See `Scene`."""
        i = number - 1
        pose, along = self.poses[i], float(self.along[i])
        views = []
        for side, camera in enumerate(cameras := pose.cameras(self.rig)):
            maps, _ = self.renderer.camera(side)
            views.append(FloorHits(camera, maps.rays, maps.lamp, self.pipeline, along + _AHEAD_M))
            picture = self.renderer.picture(
                side, i * _FRAME_S, views[side], cameras[0], pose.velocity
            )
            write_picture(folder, side, number, picture)
        pitch = np.degrees(np.arcsin(pose.rotation[2, 1]))
        told = {"along_m": along, "altitude_m": -pose.centre[1], "pitch_deg": pitch}
        place = {name: round(float(value), 4) for name, value in told.items()}
        return RenderedFrame(number, nearest_m(views[0].depth), place, self._labels(views[0]))

    def _labels(self, hits: FloorHits) -> list[str]:
        """Labels of patches: of a fault, else of the pipe, where it covers enough and is near."""
        depth, label = hits.depth.reshape(hits.what.shape), hits.what >> 3
        found = np.full(DEFAULT_GRID.n_patches, OCEAN, object)
        for number, name in CLASSES.items():
            mask = np.isfinite(depth) & (label >= number if number < PIPE else label == number)
            limit, share = _CLEAR_M, _FAULT_COVERAGE
            if number <= PIPE:
                limit, share = _HAZE / self.water.veil_growth, MIN_COVERAGE
            found[coverage(mask, DEFAULT_GRID) > 0] = UNSURE
            found[coverage(mask & (depth < limit), DEFAULT_GRID) >= share] = name
        return list(found)

    def write(self, folder: Path) -> None:
        """See `Scene`."""
        (folder / FILE_NAME).write_text(_TAXONOMY.to_toml(), encoding="utf-8")
        poses = [[n + 1, n * _FRAME_S, *_pose(pose)] for n, pose in enumerate(self.poses)]
        faults = [
            [CLASSES[one.kind], one.along_m, one.length_m, *self.pipeline.place(one)]
            for one in self.pipeline.faults
        ]
        names = ["class", "along_m", "length_m", "x_m", "y_m", "z_m"]
        for name, columns, rows in (("odometry", COLUMNS, poses), ("faults", names, faults)):
            text = pd.DataFrame(rows, columns=list(columns)).to_csv(
                index=False, lineterminator="\n", float_format="%.6f"
            )
            (folder / f"{name}.csv").write_text(text, encoding="utf-8")


def _pose(pose: CameraPose) -> list[float]:
    """Its place, and the quaternion from the camera's axes to the world's."""
    axis = cv2.Rodrigues(pose.rotation.T)[0].ravel()
    half = float(np.linalg.norm(axis)) / 2
    return [*pose.centre, np.cos(half), *(np.sinc(half / np.pi) / 2 * axis)]
