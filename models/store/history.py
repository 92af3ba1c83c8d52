"""The history of a deploy store: its entries, and the models that one may go back to.

Format 2 has ``signed_by``, the trusted key that vouched for the bundle. An entry without one is
written in format 1, so that a store without keys is read by yesterday's tokt as well, while one
that relies on signatures is refused by it.
"""

import getpass
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from typing import Any

from tokt.features.common.canonical import printable_json
from tokt.features.common.errors import ToktError, check_format
from tokt.models.bundle.signature import KEY_ID_DIGITS

FORMAT_VERSION = 2
MIN_SHA256_DIGITS = 8
"""By which a person may name a bundle."""

_SHA256 = re.compile(r"[0-9a-f]{64}")
_KEY_ID = re.compile(rf"[0-9a-f]{{{KEY_ID_DIGITS}}}")
_SINCE_2 = "signed_by"


@dataclass(frozen=True)
class Activation:
    """One entry of the history."""

    number: int  # 1 for the first activation of this store, and so on
    action: str  # deploy, rollback
    sha256: str  # of the bundle file
    name: str  # of the model
    version: str
    time: str  # UTC, ISO 8601
    who: str  # the account that ran the command
    reason: str  # what the person gave as the reason; may be empty
    signed_by: str = ""  # trusted key whose signature was found then; empty where none is asked for

    @property
    def label(self) -> str:
        """``name/version``."""
        return f"{self.name}/{self.version}"

    def to_json(self) -> dict[str, Any]:
        """As it stands in the history."""
        value = asdict(self)
        if not self.signed_by:
            del value[_SINCE_2]
        return {**value, "format_version": FORMAT_VERSION if self.signed_by else 1}


class DamagedError(ToktError):
    """A damaged entry, perhaps half of one: no tokt wrote it like this."""


def activation_from_bytes(text: bytes, where: str) -> Activation:
    """Read an entry; DamagedError if it is none, another ToktError if a newer tokt wrote it."""
    damaged = DamagedError(f"{where} is damaged (the next deployment sets it aside)")
    try:
        value = printable_json(text)
        version = value.pop("format_version")
        check_format(version, FORMAT_VERSION, where)
        entry = Activation(**value)
    except (AttributeError, ValueError, TypeError, KeyError, RecursionError):
        raise damaged from None
    if (_SINCE_2 in value) != (version == 2):
        raise damaged
    if any(type(getattr(entry, item.name)) is not item.type for item in fields(Activation)):
        raise damaged
    if entry.number < 1 or not _SHA256.fullmatch(entry.sha256):
        raise damaged
    if version == 2 and not _KEY_ID.fullmatch(entry.signed_by):
        raise damaged
    return entry


@dataclass
class RollbackStack:
    """The models that rolling back can return to, as the history has them.

    The last of the entries is active, and before it stands what each rollback would make active
    again, as far as that is known. `left` are the SHA-256 of the bundles that a person rolled back
    from and nobody activated again. A person may go back to one; nothing else may.
    """

    entries: list[Activation] = field(default_factory=list)
    left: set[str] = field(default_factory=set)

    def refusal(self, sha256: str) -> str:
        """Why nothing but a person may take this bundle again, or an empty string."""
        if sha256 in self.left:
            return "it was rolled back from"
        if sha256 not in {entry.sha256 for entry in self.entries}:
            return "damaged, or not one of the models to go back to"
        return ""


def rollback_stack(entries: Sequence[Activation]) -> RollbackStack:
    """Follow the entries, oldest first; what a missing one might have said is not guessed."""
    found = RollbackStack()
    known: set[str] = set()
    number = 0
    for entry in entries:
        if entry.number != number + 1:
            found.entries, known = [], set()
        number = entry.number
        if entry.action == "rollback":
            _go_back(found, entry, entry.sha256 in known)
        elif not found.entries or found.entries[-1].sha256 != entry.sha256:
            found.entries.append(entry)
        known.add(entry.sha256)
        found.left.discard(entry.sha256)
    return found


def _go_back(found: RollbackStack, entry: Activation, known: bool) -> None:
    """Go back down to the entry's bundle; to one that is not below, it is a step of its own."""
    stack = found.entries
    below = [at for at, past in enumerate(stack[:-1]) if past.sha256 == entry.sha256]
    gone = stack[below[-1] + 1 :] if below else stack[-1:]
    found.left.update(past.sha256 for past in gone)
    if below:
        found.entries = stack[: below[-1] + 1]
    else:
        found.entries = [*stack, entry] if known else [entry]


def named_entry(entries: Sequence[Activation], to: str) -> Activation:
    """The newest entry of the model that a person named.

    By an entry's number, the first digits of a bundle's SHA-256, or ``name/version``; ToktError if
    that names no entry, or different bundles.
    """
    if "/" in to:
        found = [entry for entry in entries if entry.label == to]
    else:
        found = [entry for entry in entries if to == str(entry.number)]
        if not found and len(to) >= MIN_SHA256_DIGITS:
            found = [entry for entry in entries if entry.sha256.startswith(to.lower())]
    if not found:
        raise ToktError(
            f"no entry {to!r} in the history (give its number, at least {MIN_SHA256_DIGITS} "
            "digits of its SHA-256, or NAME/VERSION)"
        )
    if len({entry.sha256 for entry in found}) > 1:
        raise ToktError(f"{to!r} names different bundles in the history; give the entry's number")
    return found[-1]


def stamp(reason: str) -> tuple[str, str, str]:
    """What each entry ends with: the time (UTC, to the second), the account, and the reason."""
    try:
        who = one_line(getpass.getuser())
    except (OSError, KeyError, ImportError):
        who = "unknown"
    return datetime.now(UTC).isoformat(timespec="seconds"), who, one_line(reason)


def one_line(text: str) -> str:
    """A person's text on one line that every terminal can show.

    A terminal of another encoding gives bytes that Python holds as halves of surrogate pairs; an
    entry with one in it is refused as damaged by whoever reads it.
    """
    words = " ".join(text.split())
    return "".join(sign if sign.isprintable() else "?" for sign in words)
