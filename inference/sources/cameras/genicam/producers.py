"""GenTL producers: the camera vendors' libraries, and the cameras that they list.

Opened in a camera's own process only (`process`): a producer can be opened once in a process, and
whatever one does wrong is done to that process. The runtime and the doctor ask such a process for
the list.
"""

from __future__ import annotations

import ctypes
import json
import logging
import os
import subprocess
import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from typing import Any

from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError
from tokt.features.common.extras import needed_by
from tokt.inference.sources.cameras.messages import program

PATH_VARIABLE = "GENICAM_GENTL64_PATH"
"""Folders of producers, as the GenTL standard names the variable; separated like PATH."""

_TIMEOUT_S = 30.0
_FIRST_CALL = "GCInitLib"
_MAX_COMPLAINTS = 8
_KEYS = (attrgetter("place.device"), attrgetter("serial"), attrgetter("name"))


@dataclass(frozen=True)
class Place:
    """The IDs by which a camera is found again: of its producer, its interface and itself."""

    producer: str
    interface: str
    device: str


@dataclass(frozen=True)
class ListedCamera:
    """A camera that a producer lists; what it does not say is empty."""

    place: Place
    serial: str = ""
    name: str = ""  # that its user gave it
    model: str = ""  # its vendor and model
    link: str = ""  # how it is connected (``GEV``, ``U3V``)

    def in_words(self) -> str:
        """One line."""
        about = [self.model, self.serial and f"serial {self.serial}", self.name and repr(self.name)]
        return f"{self.place.device} ({', '.join(filter(None, about))})"


@dataclass(frozen=True)
class Listing:
    """The cameras that all producers list, and what is wrong with producers."""

    producers: tuple[str, ...]  # files that could be loaded
    cameras: tuple[ListedCamera, ...]
    complaints: tuple[str, ...]  # what could not be loaded or opened, and why

    def camera(self, text: str) -> ListedCamera:
        """The camera of this ID, serial number, name or index; ToktError if none or several are."""
        for key in _KEYS:
            found = [camera for camera in self.cameras if key(camera) == text]
            if len(found) > 1:
                raise ToktError(f"{len(found)} cameras are called {text!r}: {self.in_words()}")
            if found:
                return found[0]
        if is_index(text) and int(text) < len(self.cameras):
            return self.cameras[int(text)]
        raise ToktError(f"no GenICam camera {text!r}: {self.in_words()}")

    def in_words(self) -> str:
        """What there is, in one line, with the index of each camera."""
        cameras = "; ".join(f"{i}: {camera.in_words()}" for i, camera in enumerate(self.cameras))
        found = f"found {cameras}" if cameras else f"none found with {', '.join(self.producers)}"
        if not self.producers:
            found = "no producer can be used"
        return "; ".join((found, *self.complaints))

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Listing:
        """What its `asdict` gave."""
        told = ({**camera, "place": Place(**camera["place"])} for camera in value["cameras"])
        cameras = tuple(ListedCamera(**camera) for camera in told)
        return cls(tuple(value["producers"]), cameras, tuple(value["complaints"]))


def is_index(text: str) -> bool:
    """Whether a camera is called by a number, which another may have when it is gone."""
    return text.isascii() and text.isdecimal()


def list_cameras(timeout_s: float = _TIMEOUT_S) -> Listing:
    """Ask all producers for their cameras, in a process of its own.

    ToktError if harvesters is not installed, there is no producer, or one crashes or hangs.
    """
    for package in ("harvesters", "genicam"):
        if find_spec(package) is None:
            raise ToktError(f"a genicam camera needs {package}: install the extra 'genicam'")
    try:
        ran = subprocess.run(
            program("cameras.genicam"),
            input=b'{"list": true}\n',
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ToktError(f"the GenTL producers do not answer in {timeout_s:g} s") from None
    if not ran.stdout:
        raise ToktError(f"the GenTL producers end the process with {ran.returncode}")
    answer = json.loads(ran.stdout)
    if answer["kind"] == "refused":
        raise ToktError(answer["words"])
    return Listing.from_json(answer["listing"])


@dataclass(frozen=True)
class Producers:
    """Opened producers, by their ``harvesters.core.Harvester``."""

    harvester: Any
    listing: Listing


@contextmanager
def opened_producers() -> Iterator[Producers]:
    """Open every producer in `PATH_VARIABLE` and look for cameras.

    ToktError if there is no producer, or harvesters is not installed.
    """
    files, refused = _sound(producer_files())
    # harvesters sets the filters of the whole process
    with warnings.catch_warnings(), needed_by("a genicam camera"):
        from harvesters.core import Harvester, ParameterKey, ParameterSet
    complaints = deque[str](maxlen=_MAX_COMPLAINTS)  # harvesters raises for none of them

    def keep(record: logging.LogRecord) -> bool:
        complaints.append(in_one_line(record.getMessage()))
        return False

    # No logger of the process: by default harvesters prints tracebacks.
    logger = logging.Logger("tokt.genicam", logging.WARNING)
    logger.addFilter(keep)
    with Harvester(config=ParameterSet({ParameterKey.LOGGER: logger})) as harvester:
        for file in files:
            harvester.add_file(str(file))
        harvester.update()
        cameras = tuple(_listed(info) for info in harvester.device_info_list)
        listing = Listing(tuple(map(str, files)), cameras, (*refused, *complaints))
        yield Producers(harvester, listing)


def producer_files() -> list[Path]:
    """Every producer (``*.cti``) in the folders of `PATH_VARIABLE`; ToktError if there is none."""
    variable = os.environ.get(PATH_VARIABLE, "")
    places = [Path(text) for text in variable.split(os.pathsep) if text]
    if not places:
        what = f"set {PATH_VARIABLE} to the folder of its .cti file (docs/how-to/cameras.md)"
        raise ToktError(f"no GenTL producer: install the camera vendor's, and {what}")
    found = [file for place in places for file in sorted(place.glob("*.cti"))]
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


NAME = "genicam cameras"


def genicam_finding() -> Finding:
    """The GenICam cameras there are, as another process finds them, or what is missing."""
    try:
        harvesters = f"harvesters {version('harvesters')} with genicam {version('genicam')}"
    except PackageNotFoundError as error:
        return Finding(NAME, NOTE, f"no {error.name}; GenICam cameras need the extra 'genicam'")
    try:
        producer_files()
    except ToktError as error:
        return Finding(NAME, NOTE, f"{harvesters}, but {error}")
    try:
        listing = list_cameras()
    except ToktError as error:
        return Finding(NAME, FAULT, f"{harvesters}: {error}")
    cameras = [camera.place.device for camera in listing.cameras]
    figures = {"producers": list(listing.producers), "cameras": cameras}
    state = FAULT if listing.complaints else OK if listing.cameras else NOTE
    return Finding(NAME, state, f"{harvesters}: {listing.in_words()}", figures)
