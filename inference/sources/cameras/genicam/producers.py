"""GenTL producers: the camera vendors' libraries, and the cameras that they list.

To be used in a camera's own process only (`process`): a producer can be opened once in a
process, and whatever one does wrong is done to that process.
"""

from __future__ import annotations

import ctypes
import logging
import os
import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError

from .listing import PATH_VARIABLE, ListedCamera, Listing, Place

_FIRST_CALL = "GCInitLib"
_MAX_COMPLAINTS = 8


class _Complaints(logging.Handler):
    """Keeps the last things that harvesters complained about, which it raises for none of."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.words: deque[str] = deque(maxlen=_MAX_COMPLAINTS)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the words."""
        self.words.append(in_one_line(record.getMessage()))


@dataclass(frozen=True)
class Producers:
    """Opened producers.

    Parameters
    ----------
    harvester : harvesters.core.Harvester
    listing : Listing
    """

    harvester: Any
    listing: Listing

    def info(self, camera: ListedCamera) -> Any:
        """What harvesters opens a camera of the listing with."""
        return self.harvester.device_info_list[self.listing.cameras.index(camera)]


@contextmanager
def opened_producers() -> Iterator[Producers]:
    """Open every producer in `PATH_VARIABLE` and look for cameras.

    Raises
    ------
    ToktError
        If there is no producer, or harvesters is not installed.
    """
    files, refused = _sound(producer_files())
    with warnings.catch_warnings():  # harvesters sets the filters of the whole process
        try:
            from harvesters.core import Harvester, ParameterKey, ParameterSet
        except ModuleNotFoundError as error:
            raise ToktError(f"a genicam camera needs {error.name}: install tokt[genicam]") from None
    complaints = _Complaints()
    # No logger of the process: by default harvesters prints tracebacks.
    logger = logging.Logger("tokt.genicam", logging.WARNING)
    logger.addHandler(complaints)
    with Harvester(config=ParameterSet({ParameterKey.LOGGER: logger})) as harvester:
        for file in files:
            harvester.add_file(str(file))
        harvester.update()
        cameras = tuple(_listed(info) for info in harvester.device_info_list)
        said = tuple(complaints.words)
        yield Producers(harvester, Listing(tuple(map(str, files)), cameras, (*refused, *said)))


def producer_files() -> list[Path]:
    """Every producer (``*.cti``) in the folders of `PATH_VARIABLE`.

    Raises
    ------
    ToktError
        If there is none.
    """
    variable = os.environ.get(PATH_VARIABLE, "")
    places = [Path(text) for text in variable.split(os.pathsep) if text]
    if not places:
        raise ToktError(
            f"no GenTL producer: install the camera vendor's, and set {PATH_VARIABLE} to the"
            " folder of its .cti file (docs/cameras.md)"
        )
    found = [
        file for place in places for file in (sorted(place.glob("*.cti")) if place.is_dir() else ())
    ]
    if not found:
        raise ToktError(f"no GenTL producer (*.cti) in {PATH_VARIABLE}={variable}")
    return list({file.resolve(): file for file in found}.values())


def _sound(files: list[Path]) -> tuple[list[Path], list[str]]:
    """The producers that can be loaded, and why the others cannot."""
    sound, refused = [], []
    for file in files:
        try:
            library = ctypes.CDLL(str(file))
        except OSError as error:
            refused.append(f"{file}: {in_one_line(str(error))}")
            continue
        if hasattr(library, _FIRST_CALL):
            sound.append(file)
        else:
            refused.append(f"{file}: not a GenTL producer (it has no {_FIRST_CALL})")
    return sound, refused


def _listed(info: Any) -> ListedCamera:
    interface = info.parent
    place = Place(interface.parent.id_, interface.id_, info.id_)
    # What a producer does not say harvesters has as None.
    said = {key: str(value) for key, value in info.property_dict.items() if value is not None}
    return ListedCamera(
        place,
        serial=said.get("serial_number", ""),
        name=said.get("user_defined_name", ""),
        model=" ".join(said[key] for key in ("vendor", "model") if key in said),
        link=said.get("tl_type", ""),
    )


def in_one_line(words: str) -> str:
    """Words of a library in one line."""
    return " ".join(words.split())
