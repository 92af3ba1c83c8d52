"""The deploy store: a folder of bundles on the ROV's PC, and the one that is active.

::

    store/
      versions/SHA256/bundle.tokt   every bundle ever deployed, never changed
      active                        JSON, replaced atomically: the newest history entry
      history.jsonl                 one line an activation, oldest first
      lock                          empty; the system locks it for the process that writes

``active`` is the truth. A line is added to the history after ``active`` has been replaced; if
the process dies in between, the next reader finds the entry in ``active`` and the next writer
adds the line. So whatever instant a command is interrupted at, the store loads.

A file that is damaged (by a disk, by an editor) is never taken at its word: what it said is
not guessed, and rolling back is refused. A deployment names a model itself, so it keeps the
damaged file beside the new one, as ``active.damaged-TIME`` or ``history.damaged-TIME.jsonl``,
and goes on with the lines that can be read.
"""

from __future__ import annotations

import getpass
import hashlib
import json
import os
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..features import atomic
from ..features.errors import ToktError
from ..features.file_lock import locked
from .bundle import Bundle, bundle_from_bytes

FORMAT_VERSION = 1
LOCK_WAIT_S = 10.0
"""How long a command waits for another one that is writing; that one takes about a second."""

_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Activation:
    """One entry of the history.

    Parameters
    ----------
    number : int
        1 for the first activation of this store, and so on.
    action : {"deploy", "rollback"}
    sha256 : str
        Of the bundle file.
    name, version : str
        Of the model.
    time : str
        UTC, ISO 8601.
    who : str
        The account that ran the command.
    reason : str
        What the person gave as the reason; may be empty.
    format_version : int
    """

    number: int
    action: str
    sha256: str
    name: str
    version: str
    time: str
    who: str
    reason: str
    format_version: int = FORMAT_VERSION

    @property
    def label(self) -> str:
        """``name/version``."""
        return f"{self.name}/{self.version}"


class _DamagedError(ToktError):
    """An entry that no tokt has written like this; half of one, perhaps."""


def _activation(text: bytes, where: str) -> Activation:
    damaged = f"{where} is damaged (the next deployment sets it aside)"
    try:
        value = json.loads(text)
        version = value["format_version"]
        if type(version) is int and version > FORMAT_VERSION:
            raise ToktError(f"{where} was written by a newer tokt (format {version})")
        entry = Activation(**value)
    except (ValueError, TypeError, KeyError, RecursionError):
        raise _DamagedError(damaged) from None
    wrong = [
        field for field in fields(Activation) if type(value[field.name]).__name__ != field.type
    ]
    if wrong or version < 1 or entry.number < 1 or not _SHA256.fullmatch(entry.sha256):
        raise _DamagedError(damaged)
    return entry


@dataclass(frozen=True)
class _Reading:
    """What the pointer and the history say, and what is wrong with them.

    `last_number` is the highest one that may have been given, by a damaged line as well.
    """

    active: Activation | None
    pointer_damage: str
    entries: list[Activation]
    history_damage: list[str]
    last_number: int

    @property
    def damage(self) -> list[str]:
        """One line for each thing that cannot be read."""
        return [*filter(None, [self.pointer_damage]), *self.history_damage]


def _earlier(entries: list[Activation]) -> Activation | None:
    """What was active before the newest deployment not yet undone, as far as that is known."""
    undo: list[Activation] = []
    number = 0
    for entry in entries:
        if entry.number != number + 1:
            undo = []  # what was active in between is not known
        number = entry.number
        if entry.action == "rollback":
            undo = undo[:-1] or [entry]
        elif not undo or undo[-1].sha256 != entry.sha256:
            undo.append(entry)
    return undo[-2] if len(undo) > 1 else None


def _account() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "unknown"


class Store:
    """A deploy store.

    Parameters
    ----------
    path : Path
        Its folder; made by the first deployment.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)

    @property
    def _active_file(self) -> Path:
        return self.path / "active"

    @property
    def _history_file(self) -> Path:
        return self.path / "history.jsonl"

    def _bundle_file(self, sha256: str) -> Path:
        return self.path / "versions" / sha256 / "bundle.tokt"

    def active_entry(self) -> Activation | None:
        """The newest activation, or None before the first.

        Raises
        ------
        ToktError
            If the pointer is damaged.
        """
        try:
            text = self._active_file.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ToktError(f"store {self.path}: the active pointer: {error}") from None
        return _activation(text, f"store {self.path}: the active pointer")

    def active(self) -> Bundle:
        """The active bundle, checked whole.

        Raises
        ------
        ToktError
            If the store is not there, holds no active model, or its bundle fails a check or
            cannot judge frames.
        """
        self._check_folder()
        entry = self.active_entry()
        if entry is None:
            raise ToktError(f"store {self.path} has no active model; deploy one first")
        bundle = self._load(entry.sha256)
        self._check_fit(bundle)
        return bundle

    def _check_folder(self) -> None:
        if not self.path.is_dir():
            what = "is not a folder" if self.path.exists() else "does not exist"
            raise ToktError(f"store {self.path} {what}")

    def _check_fit(self, bundle: Bundle) -> None:
        if bundle.deployment_fault:
            raise ToktError(
                f"store {self.path}: model {bundle.label} cannot guard a vehicle: "
                f"{bundle.deployment_fault}"
            )

    def _load(self, sha256: str) -> Bundle:
        path = self._bundle_file(sha256)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise ToktError(f"bundle {path}: {error.strerror or error}") from None
        if hashlib.sha256(data).hexdigest() != sha256:
            raise ToktError(f"bundle {path}: the file is not the one that was deployed")
        return bundle_from_bytes(data, str(path))

    def history(self) -> list[Activation]:
        """Every activation, oldest first.

        A line that a killed process left half-written at the end is passed over; a damaged line
        elsewhere, a damaged pointer, or anything of a newer tokt, raises ToktError.
        """
        reading = self._read()
        if reading.damage:
            raise ToktError(reading.damage[0])
        return reading.entries

    def _read(self) -> _Reading:
        """Both files, with whatever is damaged in them; ToktError if a newer tokt wrote them."""
        lines = self._history_bytes().splitlines()
        entries: list[Activation] = []
        damage: dict[int, str] = {}
        for number, line in enumerate(lines, 1):
            try:
                entries.append(_activation(line, f"store {self.path}: history line {number}"))
            except _DamagedError as error:
                damage[number] = str(error)
        active, pointer_damage = None, ""
        try:
            active = self.active_entry()
        except _DamagedError as error:
            pointer_damage = str(error)
        if active is not None:
            # Half a line of a killed process: the pointer, written before it, has its entry.
            damage.pop(len(lines), None)
            if not entries or entries[-1].number < active.number:
                entries.append(active)
        last_number = max([entry.number for entry in entries] + list(damage), default=0)
        return _Reading(active, pointer_damage, entries, list(damage.values()), last_number)

    def _history_bytes(self) -> bytes:
        try:
            return self._history_file.read_bytes()
        except FileNotFoundError:
            return b""
        except OSError as error:
            raise ToktError(f"store {self.path}: the history: {error.strerror or error}") from None

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Be the one process that writes; what the system refuses becomes a ToktError."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with locked(self.path / "lock", LOCK_WAIT_S):
                yield
        except OSError as error:
            raise ToktError(f"store {self.path}: {error.strerror or error}") from None

    def deploy(
        self, bundle: Bundle, reason: str = "", notice: Callable[[str], None] = warnings.warn
    ) -> Activation:
        """Keep a bundle and make it the active one.

        Parameters
        ----------
        bundle : Bundle
        reason : str
            Kept in the history.
        notice : callable
            Given one line for each damaged file that was set aside.

        Raises
        ------
        ToktError
            If the bundle cannot judge frames, the store's folder cannot be written, a newer tokt
            has written to it, or another process keeps writing to it.
        """
        self._check_fit(bundle)
        with self._alone():
            reading = self._read()
            target = self._bundle_file(bundle.sha256)
            # A file that was damaged since it was first deployed is made good.
            if not target.is_file() or target.read_bytes() != bundle.data:
                atomic.write_bytes(target, bundle.data)
                atomic.fsync_folder(target.parent.parent)
            self._set_aside(reading, notice)
            return self._activate(bundle, "deploy", reason, reading)

    def _set_aside(self, reading: _Reading, notice: Callable[[str], None]) -> None:
        now = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
        names = {
            self._active_file: f"active.damaged-{now}" if reading.pointer_damage else "",
            self._history_file: f"history.damaged-{now}.jsonl" if reading.history_damage else "",
        }
        for file, name in names.items():
            if name:
                # A copy: until its successor is there, the damaged file goes on being refused.
                atomic.write_bytes(self.path / name, file.read_bytes())
                notice(f"store {self.path}: {file.name} was damaged; it is kept as {name}")

    def rollback(self, reason: str = "") -> Activation:
        """Go back to the model that was active before the newest deployment not yet undone.

        Raises
        ------
        ToktError
            If the store is not there or damaged, there is no earlier model, or it no longer
            passes its checks.
        """
        self._check_folder()
        self._earlier_entry(self._read())  # refused without a trace, not even a lock file
        with self._alone():
            reading = self._read()
            bundle = self._load(self._earlier_entry(reading).sha256)
            self._check_fit(bundle)
            return self._activate(bundle, "rollback", reason, reading)

    def _earlier_entry(self, reading: _Reading) -> Activation:
        if reading.damage:
            raise ToktError(reading.damage[0])
        earlier = _earlier(reading.entries)
        if earlier is None:
            raise ToktError(f"store {self.path} has no earlier model to go back to")
        return earlier

    def _activate(self, bundle: Bundle, action: str, reason: str, reading: _Reading) -> Activation:
        entry = Activation(
            number=reading.last_number + 1,
            action=action,
            sha256=bundle.sha256,
            name=bundle.name,
            version=bundle.version,
            time=datetime.now(UTC).isoformat(timespec="seconds"),
            who=_account(),
            reason=" ".join(reason.split()),
        )
        for folder in (self.path, *self.path.glob("versions/*")):
            atomic.remove_partials(folder, older_than_s=atomic.ABANDONED_S)
        lines = "".join(json.dumps(asdict(past)) + "\n" for past in reading.entries)
        if self._history_bytes() != lines.encode():
            atomic.write_text(self._history_file, lines)
        atomic.write_text(self._active_file, json.dumps(asdict(entry), indent=2) + "\n")
        with self._history_file.open("ab") as handle:
            handle.write(json.dumps(asdict(entry)).encode() + b"\n")
            handle.flush()
            os.fsync(handle.fileno())
        return entry

    def to_json(self) -> dict[str, Any]:
        """What is active, where it comes from and all that has been, for ``tokt store --json``.

        What cannot be read is left out, with a line in ``warnings``.

        Raises
        ------
        ToktError
            If the store is not there or a newer tokt has written to it.
        """
        self._check_folder()
        reading = self._read()
        found = reading.damage
        provenance: dict[str, Any] | None = None
        if reading.active is not None:
            try:
                bundle = self._load(reading.active.sha256)
                provenance = dict(bundle.content.provenance)
                self._check_fit(bundle)
            except ToktError as error:
                found.append(f"the active model cannot be used: {error}")
        return {
            "active": None if reading.active is None else asdict(reading.active),
            "provenance": provenance,
            "history": [asdict(entry) for entry in reading.entries],
            "warnings": found,
        }
