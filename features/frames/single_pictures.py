"""Single pictures told from a sequence, by the pictures themselves.

Frames of a sequence are near copies of their neighbours, so that blocks of them are held out
together. Photographs that were taken one by one are not, and each may be held out alone.
"""

from datetime import UTC, datetime
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
_EXIF, _TAKEN, _FRACTION = 0x8769, 0x9003, 0x9291
"""Exif 2.32, tables 4 and 8: the Exif IFD, DateTimeOriginal and SubSecTimeOriginal."""


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
                times.append(seconds_taken(picture))
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


def seconds_taken(picture: Image.Image) -> float | None:
    """Return when a camera took a picture, in seconds since 1970; None where Exif does not say."""
    exif = picture.getexif().get_ifd(_EXIF)
    try:
        moment = datetime.strptime(str(exif.get(_TAKEN)), "%Y:%m:%d %H:%M:%S")
        part = float(f"0.{str(exif.get(_FRACTION) or 0).strip()}")
    except ValueError:
        return None
    return moment.replace(tzinfo=UTC).timestamp() + part


def _median_apart_s(times: list[float | None]) -> float:
    """Median time between photographs, in seconds; 0 where one has no time that can be read."""
    taken = sorted(time for time in times if time is not None)
    gaps = [after - one for one, after in pairwise(taken)]
    return median(gaps) if gaps and len(taken) == len(times) else 0.0
