"""A tower, with fish before it or none, rendered in any light with the mask of what is there."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tokt.features.common.arrays import U8
from tokt.inference.stereo.calibration import StereoCalibration
from tokt_studies.simulation.rendering.stereo_renderer import StereoRenderer
from tokt_studies.simulation.scene.closed_loop_world import World
from tokt_studies.simulation.scene.fish_and_dust import School
from tokt_studies.simulation.scene.obstacles import one_tower
from tokt_studies.simulation.scene.rig import SyntheticRig
from tokt_studies.simulation.scene.water import Water

from .patch_scores import Truth, truth_by_mask

BLUE = Water()
"""As on the sea trial: dark, by the vehicle's lamp."""
BRIGHT = replace(
    BLUE, veil=(90.0, 110.0, 80.0), veil_floor=(50.0, 60.0, 45.0), lamp=(3800.0, 3200.0, 2240.0)
)
"""As in a river by day: the water itself is bright and green, and nearly as bright everywhere."""
_TOWER_AT, _FISH_THROUGH = (0.25, -0.35, 2.9), (-0.3, 0.0, 2.2)
_FISH = 12
_AT_REST = np.zeros(3)


def by_lamp(light: float) -> Water:
    """The sea trial's water by a lamp of `light`, as a share of its own.

    What the tower, the water and its snow send back falls by one factor; the sensor's read noise
    stays.
    """
    lit: dict[str, Any] = {
        name: tuple(value * light for value in getattr(BLUE, name))
        for name in ("lamp", "veil", "veil_floor")
    }
    return replace(BLUE, **lit, snow_brightness=BLUE.snow_brightness * light)


@dataclass(frozen=True)
class BadPicture:
    """A picture in bad light, its right one where there is one, and what is in it.

    The mask, white where something is, is what is shown, the truth by patch what is scored; both
    are None where nobody marked the picture. Words say what the picture is, whose the truth is, and
    where the calibration is from; `number` is of the mission's frame it is, if it is one.
    """

    left: U8
    right: U8 | None
    mask: U8 | None
    truth: Truth | None
    calibration: StereoCalibration | None
    words: str
    truth_words: str
    calibration_words: str
    rendered: bool = False
    number: int | None = None


class LitScene:
    """One moment before a tower some three metres away; the same in every light.

    Without `tower` and `fish` it is open water.
    """

    def __init__(self, width: int, seed: int, *, tower: bool = True, fish: bool = False) -> None:
        rng = np.random.default_rng(seed)
        self._seed, self._rig = seed, SyntheticRig(rng, width)
        self._things = (one_tower(rng, _TOWER_AT),) if tower else ()
        self._fish = School(rng, _FISH_THROUGH, 0.0, count=_FISH) if fish else None

    def at(self, water: Water, words: str = "") -> BadPicture:
        """The pair in a water, with the exact mask of what is there, seen or not."""
        rig = self._rig
        world = World(water, self._things, self._fish, seed=self._seed)
        renderer = StereoRenderer(world, rig, self._seed)
        left, right = renderer.pair(0.0, _AT_REST, 0.0, _AT_REST)
        camera, _ = rig.cameras(np.eye(3), _AT_REST)
        there = np.isfinite(renderer.hits(0, 0.0, camera).depth).reshape(left.shape[:2])
        straight, shift_mm = np.zeros(5), 1000.0 * rig.translation_m.reshape(3, 1)
        cameras = rig.left, straight, rig.right, straight, rig.rotation, shift_mm
        mask = there.astype(np.uint8) * 255
        return BadPicture(
            left,
            right,
            mask,
            truth_by_mask(mask),
            StereoCalibration(*cameras, (rig.width, rig.height)),
            f"Rendered: {words}",
            "the exact rendered mask",
            "the rendered rig's exact calibration",
            rendered=True,
        )
