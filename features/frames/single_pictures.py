"""Single pictures told from a sequence, by the pictures themselves.

Frames of a sequence are near copies of their neighbours, so that blocks of them are held out
together. Photographs that were taken one by one are not, and each may be held out alone.
"""

from datetime import datetime
from io import BytesIO
from itertools import pairwise
from statistics import median

from PIL import Image, UnidentifiedImageError

from tokt.features.frames.mission import LEFT, Mission, VideoMission

_MAX_READ = 20
_LEAST_SIZES = 3
"""Sizes of the pictures of one folder: a camera that is set anew has two."""
_LEAST_CHANGES = 0.25
"""Part of neighbours in the order of their numbers that differ in size; a camera that is set anew
in the middle of a dive changes its size once."""
_LEAST_APART_S = 10.0
"""Median time between photographs. The vehicle and its water have moved on by then."""
_EXIF, _TAKEN = 0x8769, 0x9003
"""Exif 2.32, table 8: the tags of the Exif IFD and of DateTimeOriginal."""


def why_single_pictures(mission: Mission) -> str:
    """Return how it is known that a mission is no sequence; empty where it may be one.

    Known are pictures of three sizes or more, or whose size changes from one to the next, and
    photographs whose cameras wrote down times (Exif) that lie apart. At most 20 files are read, and
    none is decoded.
    """
    if isinstance(mission, VideoMission) or len(mission.cameras) > 1:
        return ""
    frames = mission.frames(LEFT)
    step = -(-len(frames) // _MAX_READ)
    sizes, times = [], []
    for frame in frames[::step]:
        try:
            with Image.open(BytesIO(mission.encoded(frame, LEFT)[0])) as picture:
                sizes.append(picture.size)
                times.append(picture.getexif().get_ifd(_EXIF).get(_TAKEN))
        except UnidentifiedImageError:  # of a format that OpenCV alone reads
            return ""
    pairs = len(sizes) - 1
    changes = sum(one != other for one, other in pairwise(sizes))
    if len(set(sizes)) >= _LEAST_SIZES or (pairs and changes >= _LEAST_CHANGES * pairs):
        return f"they have {len(set(sizes))} sizes"
    apart = _median_apart_s(times)
    if apart >= _LEAST_APART_S:
        return f"their cameras took them {apart:.0f} s apart"
    return ""


def _median_apart_s(times: list[str | None]) -> float:
    """Median time between photographs, in seconds; 0 where one has no time that can be read."""
    try:
        taken = sorted(datetime.strptime(str(text), "%Y:%m:%d %H:%M:%S") for text in times)
    except ValueError:
        return 0.0
    gaps = [(after - one).total_seconds() for one, after in pairwise(taken)]
    return median(gaps) if gaps else 0.0
