"""Pictures of a textured scene that a camera moves before, and of things that swim across it."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from tokt.features.frames.grid import DEFAULT_GRID
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.verdict import Verdict, verdict_from_mask

HEIGHT, WIDTH = 271, 360
STEP_S = 0.25
NOTHING = np.zeros((HEIGHT, WIDTH), np.uint8)


@lru_cache(24)  # a scene and a school
def texture(seed: int, sigma: float = 2.0, size: int = 1000) -> Any:
    """Spots of some pixels, float32 (size, size), around 0."""
    rng = np.random.default_rng(seed)
    spots = cv2.GaussianBlur(rng.standard_normal((size, size)).astype(np.float32), (0, 0), sigma)
    return spots / spots.std()


def motion(step: int, shift=(0.0, 0.0), turn_deg: float = 0.0, growth: float = 1.0) -> Any:
    """How a scene has moved after so many steps: an affine transform (2, 3) about the middle."""
    made = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), turn_deg * step, growth**step)
    made[:, 2] += np.array(shift) * step
    return made


def seen(scene: Any, moved: Any) -> Any:
    """The part of a scene before the camera."""
    middle = np.array([[1.0, 0.0, -(scene.shape[1] - WIDTH) / 2]])
    whole = np.vstack([moved, [0, 0, 1]]) @ np.vstack(
        [middle, [0.0, 1.0, -(scene.shape[0] - HEIGHT) / 2], [0.0, 0.0, 1.0]]
    )
    return cv2.warpAffine(scene, whole[:2], (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)


@dataclass
class Swimmer:
    """A textured ellipse that swims straight on, in pixels of the picture and pixels a step."""

    at: tuple[float, float]
    velocity: tuple[float, float]
    seed: int
    half: tuple[int, int] = (14, 7)

    def draw(self, picture: Any, mask: Any, step: int) -> None:
        x, y = np.array(self.at) + step * np.array(self.velocity)
        shape = np.zeros_like(mask)
        cv2.ellipse(shape, (round(x), round(y)), self.half, 0, 0, 360, 255, -1)
        own = cv2.warpAffine(
            texture(self.seed, 1.5, 100), np.array([[1.0, 0, x - 50], [0, 1.0, y - 50]]),
            (WIDTH, HEIGHT),
        )  # fmt: skip
        picture[shape > 0] = 120 + 30 * own[shape > 0]
        mask |= shape


def school(seed: int, count: int = 16, speed: float = 14.0) -> list[Swimmer]:
    """Some that swim about in all directions."""
    rng = np.random.default_rng(seed)
    ways = rng.uniform(0, 2 * np.pi, count)
    places = rng.uniform([90, 70], [270, 200], (count, 2))
    return [
        Swimmer(tuple(place), (speed * np.cos(way), speed * np.sin(way)), 100 + 10 * seed + number)
        for number, (place, way) in enumerate(zip(places, ways, strict=True))
    ]


def pictured(scene: Any, moved: Any, swimmers=(), step: int = 0, seed: int = 0) -> tuple[Any, Any]:
    """A gray picture with a camera's noise, and the mask of those that swim."""
    noise = np.random.default_rng([seed, step]).normal(0, 1, (HEIGHT, WIDTH))
    picture, mask = 60 + 8 * seen(scene, moved), NOTHING.copy()
    for one in swimmers:
        one.draw(picture, mask, step)
    return np.clip(picture + noise, 0, 255).astype(np.uint8), mask


def in_patches(mask: Any) -> Any:
    """The mask as a model paints it: the whole patches that it reaches well."""
    reached = DEFAULT_GRID.cells(mask).mean(axis=(1, 2)) > 25
    return DEFAULT_GRID.paint(reached, HEIGHT, WIDTH)


class Told:
    """A policy that says what it is told to."""

    def __init__(self, **verdict: Any) -> None:
        self.mask, self.more = NOTHING, verdict

    def judge(self, frame: Frame) -> Judgement:
        told = {**vars(verdict_from_mask(self.mask, "texture", "told/1")), **self.more}
        return Judgement(Verdict(**told), mask=self.mask)


def frame(step: int, picture: Any, **more: Any) -> Frame:
    return Frame(**{"number": step, "t": 1e9 + STEP_S * step, "left": picture, "right": None,
                    "timed": True, **more})  # fmt: skip
