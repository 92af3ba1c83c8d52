"""Frames, cameras, rig, poses and places of a mission as COLMAP and OpenSfM read them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.recording.run_start import RunStart
from tokt.inference.replay.logged_run import kind_of, logged_lines, open_run
from tokt.inference.replay.replay import judged_picture, pictures_of
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.odometry import Motion, Odometry, Pose, motion_between

COLMAP, OPENSFM = "colmap", "opensfm"
PROGRAMS = {COLMAP: 8, OPENSFM: 5}
"""How many of OpenCV's numbers of distortion each knows."""
Places = Mapping[int, tuple[float, float, float]]
"""Latitude and longitude in degrees, and metres above the water's surface, by frame."""
_PLACE = ("lat_deg", "lon_deg", "depth_m")
_FIXED = Pose(0.0, np.zeros(3), np.eye(3))


def logged_places(log: Path, mission: Mission) -> tuple[Places, RunStart]:
    """Where the vehicle was at the frames of a log's last run, and how that began.

    Raises ToktError if there is no such log, or it is of other pictures.
    """
    run = open_run(log)
    lines = {
        line["frame"]: line
        for line in logged_lines(log, run.run, [])
        if kind_of(line) == "frames" and isinstance(line.get(LEFT), str)
    }
    known = sorted(lines.keys() & set(mission.frames(LEFT)))
    doubt = "none of its frames is there"
    if known:
        pictures, raw = pictures_of(log, run.run, run.start, mission.path)
        doubt = judged_picture(pictures, known[0], LEFT, raw, lines[known[0]][LEFT])[1]
    if doubt:
        raise ToktError(f"{log} is not of mission {mission.name}: {doubt}")
    placed = [lines[n] for n in known if None not in map(lines[n].get, _PLACE)]
    places = {one["frame"]: (one["lat_deg"], one["lon_deg"], -one["depth_m"]) for one in placed}
    return places, run.start


@dataclass(eq=False)
class Export:
    """What is handed over."""

    mission: Mission
    calibration: StereoCalibration
    frames: Sequence[int]
    odometry: Odometry
    places: Places

    def write(self, program: str, folder: Path, progress: Any) -> dict[str, Any]:
        """Write a new folder for one of `PROGRAMS`, with pictures untouched; what it holds.

        Raises ToktError if a picture cannot be read, or the program has no camera with such a
        distortion.
        """
        c, most, posed = self.calibration, PROGRAMS[program], set(self.frames) & set(self.odometry)
        self._lenses = [(K, np.append(D, np.zeros(most))) for K, D in ((c.K1, c.D1), (c.K2, c.D2))]
        if any(D[most:].any() for _, D in self._lenses):
            raise ToktError(f"{program} knows no more than {most} numbers of a lens's distortion")
        # From the left camera's axes to the right one's, and from the fixed ones to the left one's.
        self._rig = Motion(c.R, c.T_mm.ravel() / 1000)
        self._poses = {n: motion_between(_FIXED, self.odometry[n]) for n in sorted(posed)}
        self._pairs: dict[int, list[str]] = {}  # names of the pictures
        with atomic.new_folder(folder) as new:
            (new / "images").mkdir()
            for n in progress(self.frames, len(self.frames), "export"):
                pair = [(side, *self.mission.encoded(n, side)) for side in (LEFT, RIGHT)]
                self._pairs[n] = [f"{side}_{n:06d}{ending}" for side, _, ending in pair]
                for name, (_, data, _) in zip(self._pairs[n], pair, strict=True):
                    (new / "images" / name).write_bytes(data)
            (self._write_colmap if program == COLMAP else self._write_opensfm)(new)
        placed = len(self._pairs.keys() & self.places.keys())
        counts = {"pairs": len(self._pairs), "poses": len(self._poses), "places": placed}
        return {"folder": str(folder), **counts}

    def _write_colmap(self, new: Path) -> None:
        """A database of all frames with rig and places, and a sparse model of those with poses."""
        import pycolmap

        def rigid(motion: Motion) -> Any:
            return pycolmap.Rigid3d(pycolmap.Rotation3d(motion.rotation), motion.translation_m)

        model, rig = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1)
        size = dict(zip(("width", "height"), self.calibration.frame_size, strict=True))
        with pycolmap.Database.open(new / "database.db") as database:
            for number, (K, D) in enumerate(self._lenses, 1):
                kind, count = ("FULL_OPENCV", 8) if D[4:].any() else ("OPENCV", 4)
                # The centre of COLMAP's first pixel is at (0.5, 0.5).
                numbers = [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *D[:count]]
                camera = pycolmap.Camera(camera_id=number, model=kind, params=numbers, **size)
                camera.has_prior_focal_length = True
                database.write_camera(camera, use_camera_id=True)
                model.add_camera(camera)
            rig.add_ref_sensor(model.camera(1).sensor_id)
            rig.add_sensor(model.camera(2).sensor_id, rigid(self._rig))
            database.write_rig(rig, use_rig_id=True)
            model.add_rig(rig)
            for number, (n, names) in enumerate(self._pairs.items(), 1):
                frame = pycolmap.Frame(frame_id=number, rig_id=1)
                images = [
                    pycolmap.Image(name=name, camera_id=side, image_id=2 * number + side - 2)
                    for side, name in enumerate(names, 1)
                ]
                for image in images:
                    database.write_image(image, use_image_id=True)
                    frame.add_data_id(image.data_id)
                database.write_frame(frame, use_frame_id=True)
                if n in self.places:
                    prior = pycolmap.PosePrior(position=self.places[n])
                    prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.WGS84
                    prior.corr_data_id = images[0].data_id
                    database.write_pose_prior(prior)
                if n in self._poses:
                    frame.rig_from_world = rigid(self._poses[n])
                    model.add_frame(frame)
                    for image in images:
                        image.frame_id = number
                        model.add_image(image)
        (new / "sparse").mkdir()
        model.write(new / "sparse")

    def _write_opensfm(self, new: Path) -> None:
        """Cameras, rig, each picture's camera and place, and a reconstruction without points."""
        (width, height), rig = self.calibration.frame_size, self._rig
        long = max(width, height)
        # OpenSfM measures in the picture's longer side, from its middle.
        cameras = {
            side: {
                "projection_type": "brown", "width": width, "height": height,
                "focal_x": K[0, 0] / long, "c_x": (K[0, 2] - (width - 1) / 2) / long,
                "focal_y": K[1, 1] / long, "c_y": (K[1, 2] - (height - 1) / 2) / long,
                **dict(zip(("k1", "k2", "p1", "p2", "k3"), D, strict=False)),
            }
            for side, (K, D) in zip((LEFT, RIGHT), self._lenses, strict=True)
        }  # fmt: skip
        stands = {LEFT: _opensfm_pose(Motion(np.eye(3), np.zeros(3))), RIGHT: _opensfm_pose(rig)}
        pairs, instances, shots, pictures = {}, {}, {}, dict[str, Any]()
        for n, (left, right) in self._pairs.items():
            sides, place = {left: LEFT, right: RIGHT}, self.places.get(n, ())
            pairs[str(n)] = [*sides.items()]
            where = dict(zip(("latitude", "longitude", "altitude"), place, strict=False))
            gps = {"gps": where} if where else {}
            pictures |= {name: {"camera": side, **gps} for name, side in sides.items()}
            if n in self._poses:
                pose = self._poses[n]
                other = Motion(rig.rotation @ pose.rotation, rig.of(pose.translation_m))
                instances[str(n)] = {**_opensfm_pose(pose), "rig_camera_ids": sides}
                shots[left] = {"camera": LEFT, **_opensfm_pose(pose)}
                shots[right] = {"camera": RIGHT, **_opensfm_pose(other)}
        files: dict[str, Any] = {"camera_models_overrides": cameras, "rig_cameras": stands}
        files |= {"rig_assignments": pairs, "exif_overrides": pictures}
        if shots:
            model = {"cameras": cameras, "rig_cameras": stands, "rig_instances": instances}
            files["reconstruction"] = [{**model, "shots": shots, "points": {}}]
        for name, value in files.items():
            (new / f"{name}.json").write_text(json.dumps(value, indent=1), encoding="utf-8")


def _opensfm_pose(motion: Motion) -> dict[str, list[float]]:
    turn = cv2.Rodrigues(motion.rotation)[0].ravel()
    return {"rotation": turn.tolist(), "translation": motion.translation_m.tolist()}
