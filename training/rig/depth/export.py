"""Frames, cameras, rig, poses and places of a mission as COLMAP and OpenSfM read them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.common import atomic
from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.recording.run_start import used_file
from tokt.inference.replay.logged_run import logged_lines, open_run
from tokt.inference.report import FIELDS, WITH_PLACE
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.odometry import Motion

COLMAP, OPENSFM = "colmap", "opensfm"
KINDS = (COLMAP, OPENSFM)
_SIDES = (LEFT, RIGHT)
_STILL = Motion(np.eye(3), np.zeros(3))
Places = Mapping[int, Mapping[str, float]]
"""Of each frame whose log has it: depth_m, heading_deg, lat_deg, lon_deg."""


def logged_places(log: Path) -> tuple[Places, Path | None]:
    """Where the vehicle was at the frames of a log's last run, and its odometry file, or None.

    Raises
    ------
    ToktError
        If there is no such log, it does not say how its run began, or the odometry file is not
        what it was then.
    """
    run = open_run(log)
    of_place = [each for each in FIELDS if each.since == WITH_PLACE and each.v2]
    places = {}
    for line in logged_lines(log, run.run, []):
        known = {
            one.name: float(line[one.name]) for one in of_place if one.fits(line.get(one.name))
        }
        if known and type(line.get("frame")) is int:
            places[line["frame"]] = known
    used = run.start.odometry
    if used is not None and used_file(Path(used.path)) != used:
        raise ToktError(f"{used.path} is not what it was in the run of {log}: give --odometry FILE")
    return places, None if used is None else Path(used.path)


@dataclass(frozen=True)
class Export:
    """What is handed over."""

    mission: Mission
    calibration: StereoCalibration
    frames: Sequence[int]
    poses: Mapping[int, Motion]  # of the left camera, from fixed axes to its own
    places: Places

    def write(self, kind: str, folder: Path, progress: Any) -> dict[str, Any]:
        """Write a new folder for a program of `KINDS`; what it holds.

        Raises
        ------
        ToktError
            If a picture cannot be read, or the program has no camera with such a distortion.
        """
        cameras = [_CAMERAS[kind](self.calibration, side) for side in _SIDES]
        with atomic.new_folder(folder) as new:
            names = self._pictures(new / "images", kind, progress)
            files = (
                _colmap(self, names, cameras) if kind == COLMAP else _opensfm(self, names, cameras)
            )
            for name, text in files.items():
                (new / name).parent.mkdir(exist_ok=True)
                (new / name).write_text(text, encoding="utf-8")
        posed, placed = (sum(n in of for n in names) for of in (self.poses, self.places))
        return {"folder": str(folder), "pairs": len(names), "poses": posed, "places": placed}

    def _pictures(self, folder: Path, kind: str, progress: Any) -> dict[int, tuple[str, ...]]:
        """Write both pictures of each frame, untouched; their names by frame.

        COLMAP takes pictures of one name in two folders for a pair; OpenSfM knows no folders.
        """
        between, names = "/" if kind == COLMAP else "_", {}
        for frame in progress(self.frames, len(self.frames), "export"):
            pair = [self.mission.encoded(frame, side) for side in _SIDES]
            of = [
                f"{side}{between}{frame:06d}{end}"
                for side, (_, end) in zip(_SIDES, pair, strict=True)
            ]
            for name, (data, _) in zip(of, pair, strict=True):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(data)
            names[frame] = tuple(of)
        return names

    def rig(self) -> tuple[Motion, Motion]:
        """From the left camera's axes to those of either camera, in metres."""
        return _STILL, Motion(self.calibration.R, self.calibration.T_mm.ravel() / 1000)


def _lens(
    calibration: StereoCalibration, side: str, most: int, program: str
) -> tuple[F64, list[float]]:
    """The camera matrix and `most` numbers of distortion; ToktError if it has others too."""
    K, D = (calibration.K1, calibration.D1) if side == LEFT else (calibration.K2, calibration.D2)
    numbers = np.append(D, np.zeros(most))
    if numbers[most:].any():
        raise ToktError(
            f"{program} knows {most} numbers of distortion, and the {side} camera has more"
        )
    return K, [float(number) for number in numbers[:most]]


def _colmap_camera(calibration: StereoCalibration, side: str) -> tuple[str, list[float]]:
    """Model and numbers; the centre of COLMAP's first pixel is at (0.5, 0.5)."""
    K, lens = _lens(calibration, side, 8, "COLMAP")
    model, count = ("FULL_OPENCV", 8) if any(lens[4:]) else ("OPENCV", 4)
    return model, [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *lens[:count]]


def _opensfm_camera(calibration: StereoCalibration, side: str) -> dict[str, Any]:
    """OpenSfM measures in the picture's longer side, from its middle."""
    K, (k1, k2, p1, p2, k3) = _lens(calibration, side, 5, "OpenSfM")
    width, height = calibration.frame_size
    long = max(width, height)
    return {
        "projection_type": "brown", "width": width, "height": height,
        "focal_x": K[0, 0] / long, "focal_y": K[1, 1] / long,
        "c_x": (K[0, 2] - (width - 1) / 2) / long, "c_y": (K[1, 2] - (height - 1) / 2) / long,
        "k1": k1, "k2": k2, "p1": p1, "p2": p2, "k3": k3,
    }  # fmt: skip


_CAMERAS: Mapping[str, Any] = {COLMAP: _colmap_camera, OPENSFM: _opensfm_camera}


def _colmap(
    of: Export, names: Mapping[int, Sequence[str]], cameras: Sequence[Any]
) -> dict[str, str]:
    """A sparse model of the frames with poses, the rig for the others, and places."""
    width, height = of.calibration.frame_size
    rig, frames, images = of.rig(), [], []
    posed = sorted(names.keys() & of.poses.keys())
    for number, frame in enumerate(posed, 1):
        ids = 2 * number - 1, 2 * number
        left = of.poses[frame]
        frames.append(f"{number} 1 {_numbers(left)} 2 CAMERA 1 {ids[0]} CAMERA 2 {ids[1]}")
        for place, name in enumerate(names[frame]):
            pose = _after(left, rig[place])
            images += [f"{ids[place]} {_numbers(pose)} {place + 1} {name}", ""]
    priors = [
        f"{names[n][0]} {place['lat_deg']} {place['lon_deg']} {-place['depth_m']}"
        for n, place in of.places.items()
        if n in names and {"lat_deg", "lon_deg", "depth_m"} <= place.keys()
    ]
    known = [
        {"image_prefix": f"{side}/", "camera_model_name": model, "camera_params": numbers}
        for side, (model, numbers) in zip(_SIDES, cameras, strict=True)
    ]
    known[0]["ref_sensor"] = True
    known[1]["cam_from_rig_rotation"] = _quaternion(rig[1].rotation)
    known[1]["cam_from_rig_translation"] = rig[1].translation_m.tolist()
    files = {
        "sparse/cameras.txt": [
            f"{place} {model} {width} {height} {_spaced(numbers)}"
            for place, (model, numbers) in enumerate(cameras, 1)
        ],
        "sparse/rigs.txt": [f"1 2 CAMERA 1 CAMERA 2 1 {_numbers(rig[1])}"],
        "sparse/frames.txt": frames,
        "sparse/images.txt": images,
        "sparse/points3D.txt": [],
        "ref_images.txt": priors,
        "rig_config.json": [_json([{"cameras": known}])],
    }
    wanted = {name: lines for name, lines in files.items() if lines or name.startswith("sparse")}
    return {name: "".join(f"{line}\n" for line in lines) for name, lines in wanted.items()}


def _opensfm(
    of: Export, names: Mapping[int, Sequence[str]], cameras: Sequence[Any]
) -> dict[str, str]:
    """Cameras, rig, what the log knows of each picture, and a reconstruction without points."""
    rig, models = of.rig(), dict(zip(_SIDES, cameras, strict=True))
    standing = {side: _opensfm_pose(pose) for side, pose in zip(_SIDES, rig, strict=True)}
    pairs = {str(n): dict(zip(pair, _SIDES, strict=True)) for n, pair in names.items()}
    known: dict[str, Any] = {}
    for frame, pair in names.items():
        place = of.places.get(frame, {})
        more: dict[str, Any] = {}
        if {"lat_deg", "lon_deg"} <= place.keys():
            more["gps"] = {"latitude": place["lat_deg"], "longitude": place["lon_deg"]}
            if "depth_m" in place:
                more["gps"]["altitude"] = -place["depth_m"]
        if "heading_deg" in place:
            more["compass"] = {"angle": place["heading_deg"]}
        known |= {name: {"camera": side, **more} for name, side in zip(pair, _SIDES, strict=True)}
    posed = sorted(names.keys() & of.poses.keys())
    instances = {
        str(n): {**_opensfm_pose(of.poses[n]), "rig_camera_ids": pairs[str(n)]} for n in posed
    }
    shots = {
        name: {"camera": side, **_opensfm_pose(_after(of.poses[n], pose))}
        for n in posed
        for name, side, pose in zip(names[n], _SIDES, rig, strict=True)
    }
    model = {"cameras": models, "rig_cameras": standing, "rig_instances": instances,
             "shots": shots, "points": {}}  # fmt: skip
    files = {
        "camera_models_overrides.json": models,
        "rig_cameras.json": standing,
        "rig_assignments.json": {
            n: [list(one) for one in pair.items()] for n, pair in pairs.items()
        },
        "exif_overrides.json": known,
        **({"reconstruction.json": [model]} if posed else {}),
    }
    return {name: _json(value) + "\n" for name, value in files.items()}


def _after(first: Motion, then: Motion) -> Motion:
    return Motion(then.rotation @ first.rotation, then.of(first.translation_m))


def _quaternion(rotation: F64) -> list[float]:
    """w, x, y, z of a rotation matrix."""
    turn = cv2.Rodrigues(rotation)[0].ravel()
    angle = float(np.linalg.norm(turn))
    axis = turn * (math.sin(angle / 2) / angle) if angle else turn
    return [math.cos(angle / 2), *axis.tolist()]


def _numbers(pose: Motion) -> str:
    return _spaced([*_quaternion(pose.rotation), *pose.translation_m])


def _spaced(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _opensfm_pose(pose: Motion) -> dict[str, Any]:
    """A rotation as axis and angle."""
    turn = cv2.Rodrigues(pose.rotation)[0].ravel()
    return {"rotation": turn.tolist(), "translation": pose.translation_m.tolist()}


def _json(value: Any) -> str:
    return json.dumps(value, indent=1, allow_nan=False)
