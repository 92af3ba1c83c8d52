"""A rig whose frames are rectified already, of two equal cameras; frames of the sea trial."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.frames.image_file import read_image
from tokt.inference.frame import Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.stereo.calibration import StereoCalibration

WIDTH, HEIGHT = 1360, 1024
FOCAL_PX, BASELINE_M = 2200.0, 0.3
CENTRE = np.array([679.5, 511.5])
CAMERA = np.array([[FOCAL_PX, 0, CENTRE[0]], [0, FOCAL_PX, CENTRE[1]], [0, 0, 1]])
STRAIGHT = np.zeros(5)
SHIFT_MM = np.array([[-1000 * BASELINE_M], [0.0], [0.0]])
PLAIN = StereoCalibration(CAMERA, STRAIGHT, CAMERA, STRAIGHT, np.eye(3), SHIFT_MM, (WIDTH, HEIGHT))


def even_sea(camera: int = 0, seed: int = 0, light: float = 1.0) -> np.ndarray:
    """A view with nothing in it: light that falls off, and the camera's noise; float64."""
    return light * np.linspace(25, 45, WIDTH) + camera_noise(seed)[camera]


SQUARE_PX = 320
SPECKS = 40  # in a view


def square_texture(cells: int = 80) -> np.ndarray:
    small = np.random.default_rng(3).uniform(20, 120, (cells, cells))
    return cv2.resize(small, (SQUARE_PX, SQUARE_PX))


def pair_with(
    texture: np.ndarray, x: int, y: int, disparity_px: int, seed: int = 0
) -> list[np.ndarray]:
    """Both views of an even sea with one thing in it, at (x, y) in the left one."""
    left, right = even_sea(0, seed), even_sea(1, seed)
    height, width = texture.shape
    left[y : y + height, x : x + width] = texture
    there = x - disparity_px
    right[y : y + height, max(there, 0) : there + width] = texture[:, max(-there, 0) :]
    return [view.round().astype(np.uint8) for view in (left, right)]


def store_parts(path: Path, parts: Mapping[str, Any]) -> Path:
    """Write a calibration file with cv2 alone."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in parts.items():
        storage.write(key, value)
    storage.release()
    return path


def unfit_pairs(left: np.ndarray, right: np.ndarray) -> dict[str, Frame]:
    """Pairs that cannot be judged, by what is said of them."""
    missing, cut = (
        Fault(Reason.MISSING, "no right frame 1"),
        Fault(Reason.UNREADABLE, "a.jpg cut"),
    )
    return {
        "no right": Frame(1, 0.0, left, None, NO_FAULT, missing),
        "340x256": Frame(1, 0.0, left, right[::4, ::4]),
        "right: dark": Frame(1, 0.0, left, np.zeros_like(right)),
        "left: saturated": Frame(1, 0.0, np.full_like(left, 255), right),
        "a.jpg": Frame(1, 0.0, None, right, cut),
        "no picture of 8 bits": Frame(1, 0.0, left, right[..., None].repeat(4, 2)),
    }


@cache
def lamp_light() -> np.ndarray:
    """A view of open water in a lamp's light, which falls off from left below the middle."""
    rows, columns = np.indices((HEIGHT, WIDTH), np.float32)
    return 8 + 25 * np.exp(-((columns - 560) ** 2 + (rows - 600) ** 2) / (2 * 400**2))


def lit_sea(seed: int, with_specks: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Both views of it with the cameras' noise and specks; grey levels, float32."""
    left, right = camera_noise(seed, with_specks)
    return lamp_light() + left, lamp_light() + right


def camera_noise(seed: int, with_specks: bool = True) -> list[np.ndarray]:
    """Of two cameras; moved about it is another frame's, and sooner than drawn anew."""
    noise = [np.roll(each, (7 * seed, 13 * seed), (0, 1)) for each in _camera_noise()]
    for view, drifting in zip(noise, _specks(), strict=True) if with_specks else ():
        view += np.roll(drifting, (311 * seed, 523 * seed), (0, 1))
    return noise


@cache
def _camera_noise() -> np.ndarray:
    """Noise as demosaicing leaves it, over a little of the unevenness that water has."""
    rng = np.random.default_rng(0)
    noise, unevenness = (rng.normal(0, 1, (2, HEIGHT, WIDTH)).astype(np.float32) for _ in range(2))
    layers = ((noise, 0.9, 0.6), (unevenness, 6.0, 0.25))
    for views, sigma_px, grey in layers:
        for view in views:
            cv2.GaussianBlur(view, (0, 0), sigma_px, dst=view)
            view *= grey / view.std()
    return np.asarray(noise + unevenness)


@cache
def _specks() -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.stack([specks(rng, HEIGHT, WIDTH) for _ in range(2)])


def specks(
    rng: np.random.Generator, height: int, width: int, grey_levels: float = 2.5
) -> np.ndarray:
    """Specks of the water in a lamp's light; float32."""
    chance, sigma_px = rng.random((height, width), np.float32), 4.0 * width / WIDTH
    view = (chance < SPECKS / (height * width)).astype(np.float32)
    cv2.GaussianBlur(view, (0, 0), sigma_px, dst=view)
    return np.asarray(grey_levels * 2 * np.pi * sigma_px**2 * view)


def sea_trial(mission: Path, camera: str, number: int) -> np.ndarray:
    """A frame of the real mission."""
    return read_image(mission / camera / f"tokt1_{camera[0]}_{number}.jpg")


def sea_trial_pair(mission: Path, left: int, right: int, turn: bool = False) -> list[np.ndarray]:
    """Two frames of it, the right one upside down if `turn`."""
    step = -1 if turn else 1
    other = np.ascontiguousarray(sea_trial(mission, "Right", right)[::step])
    return [sea_trial(mission, "Left", left), other]
