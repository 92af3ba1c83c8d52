"""The deploy store: a folder of bundles on the ROV's PC, and the one that is active.

::

    store/
      versions/SHA256/bundle.tokt   every bundle ever deployed, never changed
      active                        JSON, replaced atomically: the newest history entry
      history.jsonl                 one line an activation, oldest first

``active`` is the truth. A line is added to the history after ``active`` has been replaced; if
the process dies in between, the next reader finds the entry in ``active`` and the next writer
adds the line. So whatever instant a command is interrupted at, the store loads.
"""

from __future__ import annotations

import getpass
import hashlib
import json
import os
import re
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..features import atomic
from ..features.errors import ToktError
from .bundle import Bundle, bundle_from_bytes

FORMAT_VERSION = 1
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


def _activation(text: str, where: str) -> Activation:
    try:
        value = json.loads(text)
        version = value["format_version"]
        if type(version) is int and version > FORMAT_VERSION:
            raise ToktError(f"{where} was written by a newer tokt (format {version})")
        entry = Activation(**value)
    except (ValueError, TypeError, KeyError, RecursionError):
        raise _DamagedError(f"{where} is damaged") from None
    wrong = [
        field for field in fields(Activation) if type(value[field.name]).__name__ != field.type
    ]
    if wrong or version < 1 or entry.number < 1 or not _SHA256.fullmatch(entry.sha256):
        raise _DamagedError(f"{where} is damaged")
    return entry


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
            text = self._active_file.read_text("utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise ToktError(f"store {self.path}: the active pointer: {error}") from None
        return _activation(text, f"store {self.path}: the active pointer")

    def active(self) -> Bundle:
        """The active bundle, checked whole.

        Raises
        ------
        ToktError
            If the store is not there, holds no active model, or its bundle fails a check.
        """
        if not self.path.is_dir():
            what = "is not a folder" if self.path.exists() else "does not exist"
            raise ToktError(f"store {self.path} {what}")
        entry = self.active_entry()
        if entry is None:
            raise ToktError(f"store {self.path} has no active model; deploy one first")
        return self._load(entry.sha256)

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
        elsewhere, or one of a newer tokt, raises ToktError.
        """
        entries: list[Activation] = []
        lines = self._history_text().splitlines()
        for number, line in enumerate(lines, 1):
            try:
                entries.append(_activation(line, f"store {self.path}: history line {number}"))
            except _DamagedError:
                if number < len(lines):
                    raise
        active = self.active_entry()
        if active is not None and (not entries or entries[-1].number < active.number):
            entries.append(active)
        return entries

    def _history_text(self) -> str:
        try:
            return self._history_file.read_text("utf-8", errors="replace")
        except FileNotFoundError:
            return ""
        except OSError as error:
            raise ToktError(f"store {self.path}: the history: {error.strerror or error}") from None

    def deploy(self, bundle: Bundle, reason: str = "") -> Activation:
        """Keep a bundle and make it the active one.

        Raises
        ------
        ToktError
            If the store's folder cannot be written.
        """
        try:
            target = self._bundle_file(bundle.sha256)
            # A file that was damaged since it was first deployed is made good.
            if not target.is_file() or target.read_bytes() != bundle.data:
                atomic.write_bytes(target, bundle.data)
                atomic.fsync_folder(target.parent.parent)
            return self._activate(bundle, "deploy", reason)
        except OSError as error:
            raise ToktError(f"store {self.path}: {error.strerror or error}") from None

    def rollback(self, reason: str = "") -> Activation:
        """Go back to the model that was active before the newest deployment not yet undone.

        Raises
        ------
        ToktError
            If there is no earlier one, or it no longer passes its checks.
        """
        undo: list[Activation] = []
        for entry in self.history():
            if entry.action == "rollback":
                undo = undo[:-1]
            elif not undo or undo[-1].sha256 != entry.sha256:
                undo.append(entry)
        if len(undo) < 2:
            raise ToktError(f"store {self.path} has no earlier model to go back to")
        try:
            return self._activate(self._load(undo[-2].sha256), "rollback", reason)
        except OSError as error:
            raise ToktError(f"store {self.path}: {error.strerror or error}") from None

    def _activate(self, bundle: Bundle, action: str, reason: str) -> Activation:
        known = self.history()
        entry = Activation(
            number=known[-1].number + 1 if known else 1,
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
        lines = "".join(json.dumps(asdict(past)) + "\n" for past in known)
        if self._history_text() != lines:
            atomic.write_text(self._history_file, lines)
        atomic.write_text(self._active_file, json.dumps(asdict(entry), indent=2) + "\n")
        with self._history_file.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(asdict(entry)) + "\n")
            handle.flush()
            os.fsync(handle.fileno())
        return entry

    def to_json(self) -> dict[str, Any]:
        """What is active and everything that has been, for ``tokt store --json``."""
        active = self.active_entry()
        return {
            "active": None if active is None else asdict(active),
            "history": [asdict(entry) for entry in self.history()],
        }
