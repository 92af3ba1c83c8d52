"""The deploy store: a folder of bundles on the ROV's PC, and the one that is active.

::

    store/
      versions/SHA256/bundle.tokt   every bundle ever deployed, never changed
      active                        JSON, replaced atomically: the newest history entry
      active.copy                   the same entry, written just before it
      history.jsonl                 one line an activation, oldest first
      keys.json                     whose signatures count (`tokt.models.signing.trusted_keys`)
      last_good.tokt                what the runtime ran last (`tokt.models.store.last_good`)
      *.spare                       a place on the disk for a rollback when there is no other
      lock                          empty; the system locks it for the process that writes

``active`` is the truth, unless it is older than the history: then somebody put an old copy there,
and it is refused like a damaged one. A line is added to the history after ``active`` has been
replaced; if the process dies in between, the next reader finds the entry in ``active`` and the
next writer adds the line. So whatever instant a command is interrupted at, the store loads.
``active.copy`` is looked at only by a runtime that finds ``active`` refused: it is never older
than ``active``.

A file that is damaged (by a disk, by an editor) is never taken at its word: what it said is
not guessed, and rolling back is refused. A command that names a model itself keeps the
damaged file beside the new one, as ``active.damaged-TIME`` or ``history.damaged-TIME.jsonl``,
and goes on with the lines that can be read.

Reading writes nothing: the runtime needs no more than to read the folder.
"""

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from tokt.features.common import atomic
from tokt.features.common.atomic import locked
from tokt.features.common.errors import ToktError, naming, os_words
from tokt.models.bundle.bundle import Bundle, bundle_file_bytes, bundle_from_bytes
from tokt.models.signing.keys import PublicKey
from tokt.models.signing.trusted_keys import (
    ACCEPT_UNSIGNED,
    DISTRUST,
    TRUST,
    DamagedKeysError,
    KeyEvent,
    TrustedKeys,
    trusted_keys_from_bytes,
)

from .history import (
    Activation,
    DamagedError,
    RollbackStack,
    activation_from_bytes,
    named_entry,
    one_line,
    rollback_stack,
    stamp,
)

LOCK_WAIT_S = 10.0
"""How long a command waits for another one that is writing; that one takes about a second."""

SPARE_BYTES = 16384
"""What an entry takes on the disk at most, with room for a long reason."""

Notice = Callable[[str], None]


@dataclass(frozen=True)
class StoreReading:
    """The pointer and the history as read, and what is wrong with them.

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


class Store:
    """A deploy store.

    Parameters
    ----------
    path : Path
        Its folder; made by the first command that writes.

    Attributes
    ----------
    last_good_file : Path
        The bundle the runtime ran last; see `tokt.models.store.last_good`.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.last_good_file = self.path / "last_good.tokt"
        self._active_file = self.path / "active"
        self._copy_file = self.path / "active.copy"
        self._history_file = self.path / "history.jsonl"
        self._keys_file = self.path / "keys.json"

    def bundle_file(self, sha256: str) -> Path:
        """The file a bundle is kept in."""
        return self.path / "versions" / sha256 / "bundle.tokt"

    @property
    def is_there(self) -> bool:
        """Whether the folder is a store, and no other folder."""
        return self._active_file.is_file() or self._history_file.is_file()

    def active_entry(self) -> Activation | None:
        """The newest activation, or None before the first.

        Raises ToktError if the pointer is damaged, or contradicts the history: an old copy was put
        in its place.
        """
        newest = self._newest_line()  # read first: a command writes the pointer before its line
        entry = self._entry_in(self._active_file, "the active pointer")
        if entry is None or newest is None or newest.number < entry.number:
            return entry
        if (newest.number, newest.sha256) == (entry.number, entry.sha256):
            return entry
        raise DamagedError(
            f"store {self.path}: the active pointer (entry {entry.number}, {entry.label}) "
            f"contradicts the history, which ends with entry {newest.number} "
            f"({newest.action}, {newest.label}). The pointer is refused; the next deployment sets "
            "it aside"
        )

    def _newest_line(self) -> Activation | None:
        """The last entry of the history that can be read; what cannot contradicts nothing."""
        try:
            lines = self._history_bytes().splitlines()
        except ToktError:
            return None
        for line in reversed(lines):
            with suppress(ToktError):
                return activation_from_bytes(line, "")
        return None

    def _entry_in(self, file: Path, what: str) -> Activation | None:
        try:
            text = file.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise DamagedError(f"store {self.path}: {what}: {error}") from None
        return activation_from_bytes(text, f"store {self.path}: {what}")

    def active(self) -> Bundle:
        """The active bundle, checked whole.

        Raises ToktError if the store is not there or holds no active model. Also if the bundle
        fails a check, lacks a signature that the store asks for, or cannot judge frames.
        """
        self.check_folder()
        entry = self.active_entry()
        if entry is None:
            raise ToktError(f"store {self.path} has no active model; deploy one first")
        return self.runnable(entry.sha256)

    def runnable(self, sha256: str, *, golden: bool = True) -> Bundle:
        """A `bundle` that can judge frames.

        Raises
        ------
        ToktError
            As `bundle`, or if it cannot judge frames.
        """
        bundle = self.bundle(sha256, golden=golden)
        self.check_fit(bundle)
        return bundle

    def bundle(self, sha256: str, *, golden: bool = True) -> Bundle:
        """Any bundle that was ever deployed, its signature checked as well.

        Parameters
        ----------
        sha256 : str
            Of its file.
        golden : bool
            False leaves out recomputing the golden values; see `bundle_from_bytes` for when.

        Raises
        ------
        ToktError
            If it is not there, is another file, or fails a check.
        """
        path = self.bundle_file(sha256)
        data = bundle_file_bytes(path)
        if hashlib.sha256(data).hexdigest() != sha256:
            raise ToktError(f"bundle {path}: the file is not the one that was deployed")
        self.trusted_keys().check(data, f"bundle {path}")
        return bundle_from_bytes(data, str(path), golden=golden)

    def check_folder(self) -> None:
        """Raise ToktError if the store is not there."""
        if not self.path.is_dir():
            what = "does not exist; tokt deploy makes one"
            what = "is not a folder" if self.path.exists() else what
            raise ToktError(f"store {self.path} {what}")

    def check_fit(self, bundle: Bundle) -> None:
        """Raise ToktError if the bundle's model cannot judge frames."""
        if bundle.deployment_fault:
            fault = f"model {bundle.label} cannot guard a vehicle: {bundle.deployment_fault}"
            raise ToktError(f"store {self.path}: {fault}")

    def trusted_keys(self) -> TrustedKeys:
        """The keys whose signatures this store asks for.

        Raises ToktError if they cannot be known. The file is damaged, cannot be read or was written
        by a newer tokt; or it is gone, and the active model was activated by its signature.
        """
        where = f"store {self.path}: its keys file {self._keys_file.name}"
        try:
            data = self._keys_file.read_bytes()
        except FileNotFoundError:
            entries = self.read().entries
            if entries and entries[-1].signed_by:
                raise DamagedKeysError(f"{where} is gone: the store takes no bundle") from None
            return TrustedKeys()
        except OSError as error:
            raise ToktError(f"{where}: {os_words(error)}") from None
        return trusted_keys_from_bytes(data, where)

    def history(self) -> list[Activation]:
        """Every activation, oldest first.

        A line that a killed process left half-written at the end is passed over. Raises ToktError
        at a damaged line elsewhere, a damaged pointer, or anything of a newer tokt.
        """
        reading = self.read()
        if reading.damage:
            raise ToktError(reading.damage[0])
        return reading.entries

    def read(self) -> StoreReading:
        """Both files, with whatever is damaged in them; ToktError if a newer tokt wrote them."""
        lines = self._history_bytes().splitlines()
        entries: list[Activation] = []
        damage: dict[int, str] = {}
        last_number = 0
        for number, line in enumerate(lines, 1):
            where = f"store {self.path}: history line {number}"
            try:
                entries.append(activation_from_bytes(line, where))
                last_number = max(last_number, entries[-1].number)
            except DamagedError as error:
                damage[number] = str(error)
                last_number += 1  # at least: lines before it may be gone
        active, pointer_damage = None, ""
        try:
            active = self.active_entry()
        except DamagedError as error:
            pointer_damage = str(error)
        if active is not None:
            # Half a line of a killed process: the pointer, written before it, has its entry.
            if damage.pop(len(lines), None) is not None:
                last_number -= 1
            if not entries or entries[-1].number < active.number:
                entries.append(active)
            last_number = max(last_number, active.number)
        return StoreReading(active, pointer_damage, entries, list(damage.values()), last_number)

    def rollback_stack(self) -> RollbackStack:
        """The models a runtime may go back to; a lost pointer is read from its copy.

        Raises ToktError if a newer tokt wrote to the store, or its newest entry is damaged wherever
        it stands.
        """
        reading = self.read()
        entries = list(reading.entries)
        # Without a pointer and a history, the copy is of a first deployment that was killed.
        if reading.pointer_damage or (reading.active is None and entries):
            try:
                copy = self._entry_in(self._copy_file, "the copy of the active pointer")
            except DamagedError:
                copy = None
            if copy is not None and (not entries or copy.number > entries[-1].number):
                entries.append(copy)
            if entries and entries[-1].number < reading.last_number:
                disorder = f"store {self.path}: the history's lines are not in their order"
                # What is lost or out of place may have been a rollback.
                raise ToktError([disorder, *reading.history_damage][-1])
        return rollback_stack(entries)

    def _history_bytes(self) -> bytes:
        try:
            return self._history_file.read_bytes()
        except FileNotFoundError:
            return b""
        except OSError as error:
            raise ToktError(f"store {self.path}: the history: {os_words(error)}") from None

    def deploy(
        self, bundle: Bundle, reason: str = "", notice: Notice = warnings.warn
    ) -> Activation:
        """Keep a bundle and make it the active one.

        Parameters
        ----------
        bundle : Bundle
        reason : str
            Kept in the history.
        notice : callable
            Given one line for each damaged file that was set aside, and each error past the change.

        Raises
        ------
        ToktError
            If the bundle cannot judge frames or lacks a signature that the store asks for. If the
            store's folder cannot be written, a newer tokt has written to it, or another process
            keeps writing to it.
        """
        self.check_fit(bundle)
        with self._writing():
            reading = self.read()
            signed_by = self.trusted_keys().check(bundle.data, f"model {bundle.label}")
            target = self.bundle_file(bundle.sha256)
            if target.is_dir():
                raise ToktError(f"bundle {target}: a folder is in its place; remove it")
            self._keep_spares()  # no deployment without a way back
            # A file that was damaged since it was first deployed is made good.
            if not target.is_file() or target.read_bytes() != bundle.data:
                try:
                    atomic.write_bytes(target, bundle.data)
                except OSError:
                    with suppress(OSError):  # it was there before, with a damaged file
                        target.parent.rmdir()
                    raise
                atomic.fsync_folder(target.parent.parent)
                if target.read_bytes() != bundle.data:
                    raise ToktError(f"bundle {target}: what was written there cannot be read back")
            return self._activate(bundle, "deploy", reason, reading, signed_by, notice)

    def check_file(self, path: Path) -> None:
        """Refuse a bundle file that lacks a signature the store asks for, and look no further.

        Raises ToktError if it lacks one, or is not there.
        """
        if self.path.is_dir():
            self.trusted_keys().check(bundle_file_bytes(path), f"bundle {path}")

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Be the one process that writes to the store, whose folder is made where it is missing.

        What the system refuses, such as a full disk, becomes a ToktError that names what is active.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with locked(self.path / "lock", LOCK_WAIT_S):
                yield
        except OSError as error:
            why = f"store {self.path}: {os_words(error)}; {self._active_words()}"
            raise ToktError(why) from None

    def _active_words(self) -> str:
        """Say what is active now."""
        try:
            entry = self.active_entry() if self.is_there else None
        except (ToktError, OSError):
            return "what is active cannot be read"
        return f"{entry.label if entry else 'no model'} is active"

    def _keep(self, file: Path, notice: Notice) -> None:
        """Keep a damaged file under another name.

        A copy: until its successor is there, the damaged file goes on being refused.
        """
        name = f"{file.stem}.damaged-{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}{file.suffix}"
        try:
            atomic.write_bytes(self.path / name, file.read_bytes())
            kept = f"it is kept as {name}"
        except OSError as error:  # such as a full disk: no reason to stay with a bad model
            kept = f"it cannot be kept: {os_words(error)}"
        notice(f"store {self.path}: {file.name} was damaged; {kept}")

    def rollback(
        self, reason: str = "", to: str = "", notice: Notice = warnings.warn
    ) -> Activation:
        """Go back to an earlier model.

        Parameters
        ----------
        reason : str
            Kept in the history.
        to : str
            An entry's number, the first digits of a bundle's SHA-256, or ``name/version``. By
            default what was active before the newest deployment not yet undone.
        notice : callable
            As for `deploy`.

        Raises
        ------
        ToktError
            If the store or the model is not there, or the model is active already or no longer
            passes its checks. Without `to`, also if the store is damaged.
        """
        self.check_folder()
        self._goal(self.read(), to)  # refused without a trace, not even a lock file
        with self._writing():
            reading = self.read()
            goal = self._goal(reading, to)
            bundle = self.runnable(goal.sha256)
            signed_by = self.trusted_keys().check(bundle.data, f"model {bundle.label}")
            return self._activate(bundle, "rollback", reason, reading, signed_by, notice)

    def _goal(self, reading: StoreReading, to: str) -> Activation:
        """The entry whose model is to be active again."""
        if to:
            with naming(f"store {self.path}"):
                goal = named_entry(reading.entries, to)
            if reading.active is not None and goal.sha256 == reading.active.sha256:
                raise ToktError(f"store {self.path}: {goal.label} is the active model already")
            return goal
        if reading.damage:
            raise ToktError(reading.damage[0])
        stack = rollback_stack(reading.entries).entries
        if len(stack) < 2:
            raise ToktError(f"store {self.path} has no earlier model to go back to")
        return stack[-2]

    def _activate(
        self,
        bundle: Bundle,
        action: str,
        reason: str,
        reading: StoreReading,
        signed_by: str,
        notice: Notice,
    ) -> Activation:
        if reading.pointer_damage:
            self._keep(self._active_file, notice)
        if reading.history_damage:
            self._keep(self._history_file, notice)
        number, model = reading.last_number + 1, (bundle.sha256, bundle.name, bundle.version)
        entry = Activation(number, action, *model, *stamp(reason), signed_by)
        for folder in (self.path, *self.path.glob("versions/*")):
            atomic.remove_partials(folder, older_than_s=atomic.ABANDONED_S)
        lines = "".join(json.dumps(past.to_json()) + "\n" for past in reading.entries)
        if self._history_bytes() != lines.encode():
            self._write(self._history_file, lines, notice)
        text = json.dumps(entry.to_json(), indent=2) + "\n"
        self._write(self._copy_file, text, notice)
        self._write(self._active_file, text, notice)
        # It is active by now, whatever becomes of the rest.
        with self._notices("its history lacks this activation until the next one", notice):
            self._write(self._history_file, lines + json.dumps(entry.to_json()) + "\n", notice)
        with self._notices("space for a rollback on a full disk", notice):
            self._keep_spares()
        return entry

    def _write(self, file: Path, text: str, notice: Notice) -> None:
        with self._notices(file.name, notice, atomic.NotDurableError):
            atomic.write_text(file, text, _spare_of(file))

    @contextmanager
    def _notices(self, what: str, notice: Notice, kind: type[OSError] = OSError) -> Iterator[None]:
        """Go on after an error of this kind, with one line."""
        try:
            yield
        except kind as error:
            notice(f"store {self.path}: {what}: {os_words(error)}")

    def _keep_spares(self) -> None:
        """Keep the place on the disk that a rollback takes."""
        for file in (self._copy_file, self._active_file):
            atomic.keep_spare(_spare_of(file), SPARE_BYTES, SPARE_BYTES)
        lines = len(self._history_bytes())
        # Larger than needed: it is not made anew for each line.
        sizes = (lines + 2 * SPARE_BYTES, lines + 6 * SPARE_BYTES)
        atomic.keep_spare(_spare_of(self._history_file), *sizes)

    def trust(
        self, key: PublicKey, name: str, reason: str = "", notice: Notice = warnings.warn
    ) -> KeyEvent:
        """Trust a key: from now on only bundles signed by a trusted key are taken.

        Parameters
        ----------
        key : PublicKey
        name : str
            What people call it.
        reason : str
            Kept with it.
        notice : callable
            Given a line if a damaged keys file was set aside; the keys in it are trusted no more.

        Raises
        ------
        ToktError
            If it is trusted already, the store cannot be written, or a newer tokt wrote its keys.
        """
        with self._writing():
            keys = self._keys_or_none(notice)
            if key.id in keys.trusted:
                raise ToktError(f"store {self.path} trusts key {key.id} already")
            event = KeyEvent(TRUST, key.id, key.raw.hex(), one_line(name), *stamp(reason))
            return self._decide(keys, event, notice)

    def distrust(self, key_id: str, reason: str = "", notice: Notice = warnings.warn) -> KeyEvent:
        """Stop trusting a key: bundles it signed are no longer taken, the active one included.

        Parameters
        ----------
        key_id : str
            At least its first 8 digits.
        reason : str
            Kept with it.
        notice : callable
            As for `deploy`.

        Raises
        ------
        ToktError
            If the store is not there, does not trust it, or cannot be written.
        """
        self.check_folder()
        with self._writing():
            keys = self.trusted_keys()
            key = keys.named(key_id)  # its name may have been edited by hand
            event = KeyEvent(DISTRUST, key.key_id, "", one_line(key.name), *stamp(reason))
            return self._decide(keys, event, notice)

    def accept_unsigned(self, reason: str = "", notice: Notice = warnings.warn) -> KeyEvent:
        """Stop asking for signatures, and trust no key.

        Raises ToktError if the store is not there, asks for none, or cannot be written.
        """
        self.check_folder()
        with self._writing():
            keys = self._keys_or_none(notice)
            if keys.events and not keys.required:
                raise ToktError(f"store {self.path} takes unsigned bundles already")
            return self._decide(keys, KeyEvent(ACCEPT_UNSIGNED, "", "", "", *stamp(reason)), notice)

    def _keys_or_none(self, notice: Notice) -> TrustedKeys:
        """The keys, or none with a notice if their file is damaged or gone."""
        try:
            return self.trusted_keys()
        except DamagedKeysError as error:
            if self._keys_file.is_file():
                self._keep(self._keys_file, notice)
            else:
                notice(str(error))
            return TrustedKeys()

    def _decide(self, keys: TrustedKeys, event: KeyEvent, notice: Notice) -> KeyEvent:
        self._write(self._keys_file, TrustedKeys((*keys.events, event)).to_text(), notice)
        return event


def _spare_of(file: Path) -> Path:
    return file.with_name(f"{file.name}.spare")
