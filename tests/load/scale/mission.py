"""As many dives as one likes out of few rendered frames: each time with other noise."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

import tokt
from tokt.cli.output import progress
from tokt.features.common.arrays import U8
from tokt.features.frames.mission import LEFT, open_mission
from tokt.labels.formats.label_csv import COLUMNS

NAME = "scale"
DIVE_FRAMES, LABELS = 100, "labels.csv"
_NOISE = 4  # grey levels; noise of a camera, and what tells one frame's pixels from another's
_SHIFTS = 320
_QUALITY = 90


class ScaleMission:
    """A folder of dives that grows to any number of left frames, `DIVE_FRAMES` a dive.

    The dive repeats, so that a model of one block knows the next: what is measured on it is what
    work costs, never how good a model is. So many `story_frames` are rendered; a divisor of a
    block's frames makes all blocks of one kind.
    """

    def __init__(self, folder: Path, width: int, story_frames: int) -> None:
        dive = folder / "dive"
        tokt.simulate_mission(dive, n_frames=story_frames, width=width)
        rendered = open_mission(dive)
        self.path = folder / NAME
        self._pictures = [_gray(rendered.read(number)) for number in rendered.frames(LEFT)]
        self._labels = pd.read_csv(dive / "labels.csv")
        height, wide = self._pictures[0].shape
        rng = np.random.default_rng(0)
        size = (2, height + _SHIFTS, wide + _SHIFTS)
        self._more, self._less = rng.integers(0, _NOISE, size, np.uint8)

    def draw(self, number: int) -> U8:
        """Frame `number`, from 1 on; no two are equal up to 102,400."""
        picture = self._pictures[(number - 1) % len(self._pictures)]
        height, width = picture.shape
        down, right = divmod(number % _SHIFTS**2, _SHIFTS)
        window = np.s_[down : down + height, right : right + width]
        noisy = cv2.subtract(cv2.add(picture, self._more[window]), self._less[window])
        return np.asarray(noisy, np.uint8)

    def write_frames(self, count: int) -> int:
        """Write frames 1 to `count` as JPEG files, each dive with its labels; the frames' bytes."""
        for first in range(1, count + 1, DIVE_FRAMES):
            dive = self._dive(first)
            (dive / "Left").mkdir(parents=True)
            self._write_labels(dive, min(DIVE_FRAMES, count + 1 - first))
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            sizes = pool.map(self._write, range(1, count + 1))
            return sum(progress(sizes, count, "frames to measure on"))

    def _dive(self, number: int) -> Path:
        return self.path / f"{NAME}_{(number - 1) // DIVE_FRAMES:05d}"

    def _write(self, number: int) -> int:
        _, data = cv2.imencode(".jpg", self.draw(number), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        dive, frame = self._dive(number), (number - 1) % DIVE_FRAMES + 1
        (dive / "Left" / f"{dive.name}_L_{frame}.jpg").write_bytes(data.tobytes())
        return len(data)

    def _write_labels(self, dive: Path, count: int) -> None:
        story = len(self._pictures)
        rows = pd.concat(
            self._labels[self._labels.frame == number % story + 1].assign(frame=number + 1)
            for number in range(count)
        )
        rows = rows.assign(mission=dive.name)[list(COLUMNS)]
        rows.to_csv(dive / LABELS, index=False, lineterminator="\n")


def _gray(image: U8) -> U8:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
