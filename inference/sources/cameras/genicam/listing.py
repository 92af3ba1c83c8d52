"""The list of GenICam cameras, and the one in it that a user means."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import Any

from tokt.features.common.errors import ToktError

from .messages import program

PATH_VARIABLE = "GENICAM_GENTL64_PATH"
"""Folders of producers, as the GenTL standard names the variable; separated like PATH."""

_TIMEOUT_S = 30.0
_KEYS: tuple[Callable[[ListedCamera], str], ...] = (
    lambda camera: camera.place.device,
    lambda camera: camera.serial,
    lambda camera: camera.name,
)


@dataclass(frozen=True)
class Place:
    """The IDs by which a camera is found again: of its producer, its interface and itself."""

    producer: str
    interface: str
    device: str


@dataclass(frozen=True)
class ListedCamera:
    """A camera that a producer lists.

    Parameters
    ----------
    place : Place
    serial, name, model, link : str
        Its serial number, the name that its user gave it, its vendor and model, and how it is
        connected (``GEV``, ``U3V``); empty where it does not say.
    """

    place: Place
    serial: str = ""
    name: str = ""
    model: str = ""
    link: str = ""

    def in_words(self) -> str:
        """One line."""
        about = [self.model, self.serial and f"serial {self.serial}", self.name and repr(self.name)]
        return f"{self.place.device} ({', '.join(filter(None, about))})"


@dataclass(frozen=True)
class Listing:
    """The cameras that all producers list, and what is wrong with producers.

    Parameters
    ----------
    producers : tuple of str
        Files that could be loaded.
    cameras : tuple of ListedCamera
    complaints : tuple of str
        What could not be loaded or opened, and why.
    """

    producers: tuple[str, ...]
    cameras: tuple[ListedCamera, ...]
    complaints: tuple[str, ...]

    def camera(self, text: str) -> ListedCamera:
        """The camera that a user calls so: its ID, serial number or name, or its index here.

        Raises
        ------
        ToktError
            If it is none or several of them.
        """
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

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Listing:
        """What `to_json` gave."""
        cameras = tuple(
            ListedCamera(**{**camera, "place": Place(**camera["place"])})
            for camera in value["cameras"]
        )
        return cls(tuple(value["producers"]), cameras, tuple(value["complaints"]))


def is_index(text: str) -> bool:
    """Whether a camera is called by a number, which another may have when it is gone."""
    return text.isascii() and text.isdecimal()


def check_installed() -> None:
    """See that the packages are there.

    Raises
    ------
    ToktError
        If not, saying what to install.
    """
    for package in ("harvesters", "genicam"):
        if find_spec(package) is None:
            raise ToktError(f"a genicam camera needs {package}: install tokt[genicam]")


def list_cameras(timeout_s: float = _TIMEOUT_S) -> Listing:
    """Ask all producers for their cameras, in a process of its own.

    Parameters
    ----------
    timeout_s : float
        How long they may take, in seconds.

    Raises
    ------
    ToktError
        If harvesters is not installed, there is no producer, or one crashes or hangs.
    """
    check_installed()
    try:
        ran = subprocess.run(
            program(),
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
