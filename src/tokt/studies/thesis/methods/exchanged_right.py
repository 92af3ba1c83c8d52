"""The control of any stereo: exchange the right frame, or turn it upside down.

What measures distance by two pictures has nothing to say then. What says the same as before has
only looked at one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.inference.frame import Frame
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD, STATUS_WORDS
from tokt.studies.baselines.thesis_disparity import cropped
from tokt.studies.baselines.thesis_stereo import THESIS_FRAME_SIZE, disparity_map
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.inputs import StudyInputs
from tokt.training.rig.depth.pair_depths import DepthRow, measure_depths

Image = NDArray[np.uint8]
Rights = Callable[[int], Image]

OWN, ANOTHER, TURNED = "its own", "another frame's", "its own, upside down"
KINDS = (OWN, ANOTHER, TURNED)


@dataclass(frozen=True)
class Exchanged:
    """Results of one left frame with one right frame.

    Parameters
    ----------
    frame : int
        Of the left camera.
    right : str
        One of `KINDS`.
    ours : DepthRow
        The runtime's.
    thesis_matched, thesis_mean : float
        Part of the thesis's cropped map that has a disparity, and its mean, 0..255.
    thesis_changed : float
        Part of that map's pixels that have a disparity now and had none with the frame's own
        right frame, or the other way round.
    """

    frame: int
    right: str
    ours: DepthRow
    thesis_matched: float
    thesis_mean: float
    thesis_changed: float

    @property
    def ours_matched(self) -> float:
        """Part of our rectified left view that is matched; 0 where no matching was done."""
        return self.ours.valid_fraction or 0.0

    def to_row(self) -> dict[str, float | int | str | None]:
        """A row of the table."""
        return {
            "left frame": self.frame,
            "right frame": self.right,
            "ours: matched %": round(100 * self.ours_matched, 3),
            "ours: status": STATUS_WORDS[self.ours.status],
            "ours: near end m": self.ours.distance_m,
            "thesis: matched %": round(100 * self.thesis_matched, 3),
            "thesis: mean value": round(self.thesis_mean, 3),
            "thesis: status": int(self.thesis_mean > STATUS_MEAN_THRESHOLD),
            "thesis: pixels changed %": round(100 * self.thesis_changed, 3),
        }


def exchange(
    inputs: StudyInputs, calibration: StereoCalibration, frames: Sequence[int]
) -> list[Exchanged]:
    """Judge left frames with their own right frame, another one's, and their own upside down.

    Another one's is that of the frame half the list away. Every kind is a run of its own, with a
    detector of its own, as if the right camera gave nothing else.

    Parameters
    ----------
    inputs : StudyInputs
    calibration : StereoCalibration
    frames : sequence of int
        Two and more, in order.

    Raises
    ------
    ToktError
        If there are fewer.
    """
    if len(frames) < 2:
        raise ToktError("to exchange right frames takes two pairs with something in them")
    half = len(frames) // 2
    others = dict(zip(frames, [*frames[half:], *frames[:half]], strict=True))
    rights: dict[str, Rights] = {
        OWN: lambda number: right_of(inputs, number),
        ANOTHER: lambda number: right_of(inputs, others[number]),
        TURNED: lambda number: np.ascontiguousarray(right_of(inputs, number)[::-1]),
    }
    seen = {number: cropped(_map(inputs, number, rights[OWN])) for number in frames}
    found = []
    for kind, right in rights.items():
        detector = DisparityDetector(calibration, GRID)
        for row in measure_depths(detector, _frames(inputs, frames, right)):
            now = seen[row.frame]
            if kind != OWN:
                now = cropped(_map(inputs, row.frame, right))
            changed = float(((now > 0) != (seen[row.frame] > 0)).mean())
            matched = float((now > 0).mean())
            found.append(Exchanged(row.frame, kind, row, matched, float(now.mean()), changed))
    return found


def right_of(inputs: StudyInputs, number: int) -> Image:
    """A right frame. Raises ToktError where it cannot be read."""
    right = inputs.right(number)
    if right is None:
        raise ToktError(f"right frame {number} cannot be read")
    return right


def at_thesis_size(frame: Image) -> Image:
    """A frame of the size that the thesis's settings in pixels are for."""
    if frame.shape[1::-1] == THESIS_FRAME_SIZE:
        return frame
    return np.asarray(cv2.resize(frame, THESIS_FRAME_SIZE, interpolation=cv2.INTER_CUBIC), np.uint8)


def _map(inputs: StudyInputs, number: int, right: Rights) -> Image:
    return disparity_map(at_thesis_size(inputs.left(number)), at_thesis_size(right(number)))


def _frames(inputs: StudyInputs, frames: Sequence[int], right: Rights) -> Iterator[Frame]:
    for number in frames:
        yield Frame(number, float(number), inputs.left(number), right(number))
