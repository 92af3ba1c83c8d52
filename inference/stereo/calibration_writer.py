"""Write a stereo calibration as a file that `load_calibration` and OpenCV alone can read."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError

from .calibration import StereoCalibration
from .calibration_files import FORMAT_VERSION, PARTS
from .rectify import rectifying

_KINDS = {
    ".yml": cv2.FILE_STORAGE_FORMAT_YAML,
    ".yaml": cv2.FILE_STORAGE_FORMAT_YAML,
    ".json": cv2.FILE_STORAGE_FORMAT_JSON,
    ".xml": cv2.FILE_STORAGE_FORMAT_XML,
}
_MAX_NOTE = 2000


def write_calibration(
    path: Path | str, calibration: StereoCalibration, notes: Mapping[str, str] | None = None
) -> None:
    """Write an OpenCV FileStorage (.yml, .yaml, .json or .xml), whole or not at all.

    It holds K1 D1 K2 D2 R T_mm image_width image_height, the R1 and R2 that ``cv2.stereoRectify``
    derives from them, and ``format_version``. `notes` say how it was made: they are written under
    ``provenance``, for people. Keys are words of letters, digits and underscores; line breaks
    become spaces, quotes around it are left out.

    Raises ToktError if the name ends otherwise; ValueError if a note's key is no word, or its text
    is longer than 2000 characters.
    """
    path = Path(path)
    kind = _KINDS.get(path.suffix.lower())
    if kind is None:
        raise ToktError(f"a calibration file ends in {', '.join(_KINDS)}, not as {path.name}")
    storage = cv2.FileStorage(
        path.suffix.lower(), cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | kind
    )
    try:
        _fill(storage, calibration, notes or {})
    finally:
        text = storage.releaseAndGetString()
    atomic.write_text(path, text)


def _fill(storage: cv2.FileStorage, known: StereoCalibration, notes: Mapping[str, str]) -> None:
    R1, R2, *_ = rectifying(known)
    storage.write("format_version", FORMAT_VERSION)
    storage.write("image_width", known.frame_size[0])
    storage.write("image_height", known.frame_size[1])
    for name in PARTS:
        storage.write(name, np.atleast_2d(getattr(known, name)))  # OpenCV 4 knows 1-d ones not
    storage.write("R1", R1)
    storage.write("R2", R2)
    storage.startWriteStruct("provenance", cv2.FileNode_MAP)
    for name, note in notes.items():
        # OpenCV takes a text between quotes, or one quote, for quoted already.
        words = " ".join(note.split()).strip("\"'")
        if not (name.isascii() and name.isidentifier()) or len(words) > _MAX_NOTE:
            raise ValueError(f"no note for a calibration file: {name!r}")
        storage.write(name, words)
    storage.endWriteStruct()
