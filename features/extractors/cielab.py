"""CIELAB colours of sRGB levels that are finer than whole ones.

Reference: CIE 15:2004, for sRGB (IEC 61966-2-1) and D65.
"""

from functools import lru_cache

import numpy as np

from tokt.features.common.arrays import F64, I64
from tokt.features.kernels.quantization import STEPS_PER_LEVEL

# From linear sRGB (columns B, G, R) to X, Y, Z over those of white (IEC 61966-2-1).
_XYZ = np.array(
    [
        [0.1804375, 0.3575761, 0.4124564],
        [0.0721750, 0.7151522, 0.2126729],
        [0.9503041, 0.1191920, 0.0193339],
    ]
) / np.array([[0.95047], [1.0], [1.08883]])
_DARK, _SLOPE = 216 / 24389, 24389 / 27 / 116


@lru_cache(maxsize=1)
def _linear() -> F64:
    """Linear light of an sRGB level in steps of 1/256, 0 to 255 levels."""
    level = np.arange(255 * STEPS_PER_LEVEL + 1) / (255.0 * STEPS_PER_LEVEL)
    return np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)


def lab_of(bgr16: I64) -> F64:
    """CIELAB of sRGB colours, float64, shape (..., 3).

    These are blue, green and red in 1/256 level, 0 to 255 * 256.
    """
    xyz = _linear()[bgr16] @ _XYZ.T
    curved = np.where(xyz > _DARK, np.cbrt(xyz), _SLOPE * xyz + 16 / 116)
    x, y, z = np.moveaxis(curved, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)
