"""A run's beginning: the fields of a log's ``start`` event, from which a replay begins alike."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np

from tokt.features.common.errors import ToktError, check_format, os_errors_as
from tokt.features.common.held_files import file_bytes
from tokt.features.kernels.dispatch import KERNELS
from tokt.inference.clock import Clock
from tokt.inference.config import NEAR, Limits, RunConfig

FORMAT_VERSION = 1
"""Of the event's fields. To change them: raise this, keep reading the older ones, and prove it with
a test that reads one."""


@dataclass(frozen=True)
class ModelName:
    """A model, ``name/version``, and its bundle file."""

    label: str
    sha256: str


@dataclass(frozen=True)
class UsedFile:
    """A file that a run read when it began."""

    path: str
    sha256: str


def used_file(path: Path) -> UsedFile:
    """A file as the run reads it; ToktError if it cannot be read."""
    with os_errors_as(f"cannot read {path}"):
        return UsedFile(str(path.absolute()), hashlib.sha256(file_bytes(path)).hexdigest())


def new_run_id(clock: Clock) -> str:
    """A name for a run, such as ``run-20160420-101112-3fa2c1``: fit for a folder, and its own even
    where the clock was set back.
    """
    moment = datetime.fromtimestamp(clock.time(), UTC)
    return f"run-{moment:%Y%m%d-%H%M%S}-{uuid.uuid4().hex[:6]}"


def software() -> dict[str, str]:
    """What computes a verdict on this machine, besides model and calibration."""
    from tokt.features.common.machine import installed_version

    return {
        "tokt": installed_version("tokt") or "not installed",
        "kernels": KERNELS.name,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


@dataclass(frozen=True)
class RunStart:
    """What a run began with."""

    source: str  # as it was given to ``--source``
    policy: str
    live: bool = False  # whether its frames came in real time
    limits: Limits = field(default_factory=Limits)
    model: ModelName | None = None  # of the first frame; None without, or if it failed to load
    model_fault: str = ""  # why it could not be loaded
    model_note: str = ""  # why it is not the store's active one, where it is not
    models_from: str = ""  # the bundle file or the store; empty without
    stereo_way: str | None = None  # as in `StereoSetup`; None without a calibration
    stereo_scale: float | None = None
    calibration: UsedFile | None = None
    odometry: UsedFile | None = None
    pixel_format: str | None = None
    threads: int = 1
    frame_rule: Mapping[str, Any] | None = None  # the model's, as JSON
    record: str | None = None  # where frames are recorded
    anchor: float | None = None  # share of the picture at which an object is to be held
    fixed_boundary: bool = False  # whether the boundary was left where training put it
    moving: str | None = NEAR  # which moving things are avoided; None: nobody looked for them
    masks: Mapping[str, Any] | None = None  # what is no view, as `CameraMasks.to_json` gives it
    # What the frames of --sharp-frames show, as `sight_to_json` gives it: no sizes where they were
    # gone as a watchdog started the run again. None without that option.
    sight: Mapping[str, Any] | None = None
    stereo_fault: str = ""  # why there was no calibration where there should have been one
    software: Mapping[str, str] = field(default_factory=software)

    @classmethod
    def of(cls, config: RunConfig, **found: Any) -> Self:
        """How a run of these options begins; `found` is what they do not say.

        A file that cannot be read any more is left out: a replay will miss it.
        """
        said, place = config.logged(), config.model.store or config.model.file
        for name in ("calibration", "odometry"):
            path, said[name] = said[name], None
            with suppress(ToktError):
                said[name] = None if path is None else used_file(path)
        if said["calibration"] is None:
            said |= {"stereo_way": None, "stereo_scale": None}
        said["record"] = None if said["record"] is None else str(said["record"])
        models_from = "" if place is None else str(place.absolute())
        return cls(**{**said, "limits": config.limits, "models_from": models_from, **found})

    def fields(self) -> dict[str, Any]:
        """The event's fields, JSON."""
        return {"format_version": FORMAT_VERSION, **asdict(self)}

    @classmethod
    def from_fields(cls, value: Mapping[str, Any], where: str) -> RunStart:
        """What `fields` gave, among other entries; ToktError if it is not that, or newer."""
        try:
            check_format(value.get("format_version"), FORMAT_VERSION, f"{where}: the log")
            return _read(value)
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            detail = f"{type(error).__name__}: {error}"
            raise ToktError(f"{where}: its start event cannot be read ({detail})") from None


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


_LATER = {
    "model_note": "",
    "anchor": None,
    "fixed_boundary": False,
    "moving": None,
    "masks": None,
    "sight": None,
    "stereo_fault": "",
}
"""What the first logs do not have."""
_READ: dict[str, Callable[[Any], Any]] = {
    "str": _text,
    "bool": bool,
    "int": int,
    "float": float,
    "Limits": lambda value: Limits(**value),
    "ModelName": lambda value: ModelName(_text(value["label"]), _text(value["sha256"])),
    "UsedFile": lambda value: UsedFile(_text(value["path"]), _text(value["sha256"])),
    "Mapping[str, Any]": lambda value: value,
    "Mapping[str, str]": lambda value: {_text(name): _text(value[name]) for name in value},
}
"""Their readers, by the fields' types."""


def _read(value: Mapping[str, Any]) -> RunStart:
    known: dict[str, Any] = {}
    for each in fields(RunStart):
        found = {**_LATER, **value}[each.name]
        kind, _, optional = str(each.type).partition(" | ")
        known[each.name] = None if optional and found is None else _READ[kind](found)
    return RunStart(**known)
