"""The thesis's disparity pipeline, which `tokt bench` measures stereo against, and its point cloud.

Both pictures gray and undistorted, block matching over the whole frame, the disparities stretched
to 0..255 and read as a mask. The pair is not rectified, and the search ends below the smallest
true disparity of the mission, so what is white is where the *left* picture has enough texture.
Ported in own words with the settings of the published program; its verdict is as
`tokt.inference.verdict` corrects it.

The cloud's projection is that of the author's own earlier program (points3Dmaker): the map's
0..255 are taken for disparities, a focal length of 57 (the camera's 2222 px times 35 over 1360, in
whole numbers as its Python divided), the mean of the printed principal points, and no baseline, so
that its lengths have no unit. Whether figure 3.10 was drawn with exactly this is not printed.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from tokt.features.common.arrays import F64, U8, Bools
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD, Verdict, verdict_from_mask

Camera = tuple[F64, F64]
"""Matrix, and coefficients of the distortion."""

THESIS_FRAME_SIZE = (1360, 1024)
"""Width and height in pixels of the frames that the settings are for."""
THESIS_SIZE_WORDS = "x".join(map(str, THESIS_FRAME_SIZE))

# Tables 3.3 and 3.4: fx, fy in pixels, and the coefficients as the program hands them to OpenCV
# (k1, k2, p1, p2, k3); it leaves the principal point at 0, 0.
LEFT_CAMERA = np.diag([2222.72426, 2190.48031, 1]), np.array([0.27724, 0.28163, 0, 0, -0.06867])
RIGHT_CAMERA = np.diag([2226.10095, 2195.17250, 1]), np.array([0.29407, 0.29892, 0, 0, -0.08315])
BLOCK_PX, MIN_DISPARITY_PX, N_DISPARITIES_PX = 9, -39, 112
CROP_PX = 200
"""Settings of the pipeline, in pixels of frames of its size."""
FOCAL, CENTRE = 2222 * 35 // 1360, ((681.42537 + 637.64260) / 2, (22.08306 + 33.60849) / 2)
"""Of the cloud. Source: points3Dmaker of ROV_objectAvoidance_StereoVision."""


@dataclass(frozen=True)
class ThesisStereoResult:
    """The pipeline's result for one pair.

    The mean is of the stretched disparities without `CROP_PX` columns at either side, 0..255; the
    verdict's centre and box are those of the dilated mask, in pixels of the cropped frame.
    """

    mean: float
    verdict: Verdict

    @property
    def obstacle(self) -> bool:
        """Whether its program sends status 1."""
        return self.mean > STATUS_MEAN_THRESHOLD


def undistorted(frame: U8, camera: Camera) -> U8:
    """A frame, gray and undistorted."""
    gray = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.undistort(gray, *camera), np.uint8)


def undistorted_pair(left: U8, right: U8) -> tuple[U8, U8]:
    """Both frames of a pair, gray and undistorted."""
    return undistorted(left, LEFT_CAMERA), undistorted(right, RIGHT_CAMERA)


def block_matching(disparities: int = N_DISPARITIES_PX) -> cv2.StereoBM:
    """Block matching by table 3.5, or that of another number of disparities."""
    matcher = cv2.StereoBM.create(disparities, BLOCK_PX)
    matcher.setPreFilterType(cv2.StereoBM_PREFILTER_XSOBEL)
    matcher.setPreFilterSize(5)
    matcher.setPreFilterCap(61)
    matcher.setMinDisparity(MIN_DISPARITY_PX)
    matcher.setTextureThreshold(507)
    matcher.setUniquenessRatio(0)
    matcher.setSpeckleRange(8)
    matcher.setSpeckleWindowSize(0)
    return matcher


_MATCHER = block_matching()


def disparity_map(left: U8, right: U8) -> U8:
    """The disparities of a decoded pair of 1360x1024 stretched to 0..255, margin included.

    They are uint8, (1024, 1360); 0 is where nothing was matched.
    """
    found = _MATCHER.compute(*undistorted_pair(left, right))
    stretched = cv2.normalize(found, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    return np.asarray(stretched, np.uint8)


def cropped(stretched: U8) -> U8:
    """A map without its margin."""
    return stretched[:, CROP_PX:-CROP_PX]


def judge_pair(left: U8, right: U8) -> ThesisStereoResult:
    """Judge one decoded pair of 1360x1024, gray or BGR."""
    inside = cropped(disparity_map(left, right))
    mask = np.asarray(cv2.dilate(inside, np.ones((5, 5), np.uint8), iterations=2), np.uint8)
    return ThesisStereoResult(float(cv2.mean(inside)[0]), verdict_from_mask(mask, "thesis"))


def thesis_cloud(stretched: U8) -> tuple[F64, Bools]:
    """The points (n, 3) of a map, without a unit, and which pixels they are.

    x to the right, y up, z backwards, as its program writes them.
    """
    (cx, cy), f = CENTRE, FOCAL
    projection = np.array([[1, 0, 0, -cx], [0, -1, 0, cy], [0, 0, 0, -f], [0, 0, 1, 0]])
    matched = stretched > 0
    points = cv2.reprojectImageTo3D(stretched.astype(np.float32), projection)
    return np.asarray(points[matched], np.float64), matched


def in_thesis_view(points: F64, camera: Camera) -> F64:
    """Where points (n, 2) of a frame lie in the picture that the thesis undistorts it to."""
    seen = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 2)
    moved = cv2.undistortPoints(seen, *camera, None, None, camera[0])
    return np.asarray(moved, np.float64).reshape(-1, 2)


def searched(left: F64, right: F64) -> tuple[F64, Bools]:
    """Disparities in pixels of points (n, 2) matched in a pair's frames, and which it can find.

    It can where its search covers that disparity, and the point is in one row, give or take a
    block's half, of both of its pictures.
    """
    seen = in_thesis_view(left, LEFT_CAMERA), in_thesis_view(right, RIGHT_CAMERA)
    disparity = seen[0][:, 0] - seen[1][:, 0]
    rows = np.abs(seen[0][:, 1] - seen[1][:, 1]) <= BLOCK_PX / 2
    last = MIN_DISPARITY_PX + N_DISPARITIES_PX - 1
    return disparity, (disparity >= MIN_DISPARITY_PX) & (disparity <= last) & rows
