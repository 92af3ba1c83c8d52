"""The thesis's disparity pipeline: what `tokt bench` measures stereo against.

Both pictures gray and undistorted, block matching over the whole frame, the disparities stretched
to 0..255 and read as a mask. The pair is not rectified, and the search ends below the smallest
true disparity of the mission, so what is white is where the *left* picture has enough texture.
Ported in own words with the settings of the published program; its verdict is as
`tokt.inference.verdict` corrects it.

References
----------
L. S. Brusletto, *Computer Vision Based Obstacle Avoidance for a Remotely Operated Vehicle*,
NTNU 2016: cameras in tables 3.3 and 3.4, the pipeline in its program AURlabCVsimulator.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.inference.verdict import STATUS_MEAN_THRESHOLD, Verdict, verdict_from_mask

THESIS_FRAME_SIZE = (1360, 1024)
"""Width and height in pixels of the frames that the settings are for."""

# fx, fy in pixels, and the coefficients as the program hands them to OpenCV (k1, k2, p1, p2, k3);
# it leaves the principal point at 0, 0.
LEFT_CAMERA = (2222.72426, 2190.48031, (0.27724, 0.28163, 0.0, 0.0, -0.06867))
RIGHT_CAMERA = (2226.10095, 2195.17250, (0.29407, 0.29892, 0.0, 0.0, -0.08315))
BLOCK_PX, MIN_DISPARITY_PX, N_DISPARITIES_PX = 9, -39, 112
_PREFILTER_PX, _PREFILTER_CAP = 5, 61
_TEXTURE_THRESHOLD, _SPECKLE_RANGE_PX = 507, 8
CROP_PX = 200
"""Settings of the pipeline, in pixels of frames of its size."""
_DILATIONS = 2
_DILATED_BY = np.ones((5, 5), np.uint8)


@dataclass(frozen=True)
class ThesisStereoResult:
    """The pipeline's result for one pair.

    Parameters
    ----------
    mean : float
        Of the stretched disparities without `CROP_PX` columns at either side, 0..255.
    verdict : Verdict
        Centre and box are those of the dilated mask, in pixels of the cropped frame.
    """

    mean: float
    verdict: Verdict

    @property
    def obstacle(self) -> bool:
        """Whether its program sends status 1."""
        return self.mean > STATUS_MEAN_THRESHOLD


def _undistorted(
    frame: NDArray[np.uint8], camera: tuple[float, float, tuple[float, ...]]
) -> NDArray[np.uint8]:
    gray = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    fx, fy, distortion = camera
    matrix = np.diag([fx, fy, 1.0])
    return np.asarray(cv2.undistort(gray, matrix, np.array(distortion)), np.uint8)


def _matcher() -> cv2.StereoBM:
    matcher = cv2.StereoBM.create(N_DISPARITIES_PX, BLOCK_PX)
    matcher.setPreFilterType(cv2.StereoBM_PREFILTER_XSOBEL)
    matcher.setPreFilterSize(_PREFILTER_PX)
    matcher.setPreFilterCap(_PREFILTER_CAP)
    matcher.setMinDisparity(MIN_DISPARITY_PX)
    matcher.setTextureThreshold(_TEXTURE_THRESHOLD)
    matcher.setUniquenessRatio(0)
    matcher.setSpeckleRange(_SPECKLE_RANGE_PX)
    matcher.setSpeckleWindowSize(0)
    return matcher


_MATCHER = _matcher()


def disparity_map(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The disparities of a decoded pair stretched to 0..255, margin included.

    Parameters
    ----------
    left, right : array of uint8, shape (1024, 1360) or (1024, 1360, 3)

    Returns
    -------
    numpy.ndarray
        uint8, (1024, 1360); 0 is where nothing was matched.
    """
    found = _MATCHER.compute(_undistorted(left, LEFT_CAMERA), _undistorted(right, RIGHT_CAMERA))
    stretched = cv2.normalize(found, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    return np.asarray(stretched, np.uint8)


def judge_pair(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> ThesisStereoResult:
    """Judge one decoded pair.

    Parameters
    ----------
    left, right : array of uint8, shape (1024, 1360) or (1024, 1360, 3)
    """
    cropped = disparity_map(left, right)[:, CROP_PX:-CROP_PX]
    mask = np.asarray(cv2.dilate(cropped, _DILATED_BY, iterations=_DILATIONS), np.uint8)
    return ThesisStereoResult(float(cv2.mean(cropped)[0]), verdict_from_mask(mask, "thesis"))
