"""The keys a deploy store trusts, in its file ``keys.json``: who said so, when and why.

The file is the list of what people did, oldest first; what holds now follows from it. A store in
which nobody ever trusted a key has no such file and takes any sound bundle. From the first trusted
key on it takes none without the signature of a key it trusts, and that stays so when the last key
is distrusted: then it takes nothing, until a person says that unsigned bundles are welcome again.

The file is never taken at its word in part: while it is damaged the store takes no bundle at all.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from tokt.features.common.canonical import printable_json
from tokt.features.common.errors import ToktError, check_format
from tokt.models.bundle.bundle import signed_parts

from .keys import PUBLIC_KEY_BYTES, PublicKey

FORMAT_VERSION = 1
TRUST, DISTRUST, ACCEPT_UNSIGNED = "trust", "distrust", "accept unsigned"
MIN_ID_DIGITS = 8
"""By which a person may name a key."""


@dataclass(frozen=True)
class KeyEvent:
    """A decision about a store's keys."""

    action: str  # trust, distrust, accept unsigned
    key_id: str  # empty for "accept unsigned"
    public_key: str  # the key itself, 64 hexadecimal digits; for "trust" only
    name: str  # of the key's file, for people; for "trust" and "distrust"
    time: str  # UTC, ISO 8601
    who: str  # the account that ran the command
    reason: str  # may be empty


class DamagedKeysError(ToktError):
    """A keys file that is damaged: no tokt wrote it like this."""


@dataclass(frozen=True)
class TrustedKeys:
    """The contents of a store's keys file."""

    events: tuple[KeyEvent, ...] = ()  # oldest first

    @property
    def trusted(self) -> dict[str, KeyEvent]:
        """The keys trusted now, by id, each with the event that made it so."""
        found: dict[str, KeyEvent] = {}
        for event in self.events:
            if event.action == TRUST:
                found[event.key_id] = event
            elif event.action == DISTRUST:
                found.pop(event.key_id, None)
            else:
                found = {}
        return found

    @property
    def required(self) -> bool:
        """Whether a bundle has to be signed."""
        return bool(self.events) and self.events[-1].action != ACCEPT_UNSIGNED

    def named(self, key_id: str) -> KeyEvent:
        """The trusted key whose id starts like that. Raises ToktError if not exactly one does."""
        found = [event for key, event in self.trusted.items() if key.startswith(key_id.lower())]
        if len(key_id) < MIN_ID_DIGITS or len(found) != 1:
            known = ", ".join(self.trusted) or "none"
            wanted = f"at least {MIN_ID_DIGITS} digits; trusted: {known}"
            raise ToktError(f"{key_id!r} is not the id of one key this store trusts ({wanted})")
        return found[0]

    def check(self, data: bytes, where: str) -> str:
        """Check that a trusted key signed a bundle file, before anything else in it is read.

        Returns the id of the key, or an empty string where no signature is asked for. `where` is
        what to call the bundle in an error.

        Raises ToktError if one is asked for and there is none that is right, or the package
        cryptography is missing.
        """
        if not self.required:
            return ""
        trusted = self.trusted
        if not trusted:
            raise ToktError(f"{where}: this store trusts no key any more, and so takes no bundle")
        manifest, signature = signed_parts(data, where)
        if signature is None:
            words = "not signed; this store takes only what a key it trusts signed"
            raise ToktError(f"{where}: {words}")
        key = trusted.get(signature.key_id)
        if key is None:
            said = f"said to be signed by key {signature.key_id}"
            raise ToktError(f"{where}: {said}, which this store does not trust")
        if not PublicKey(bytes.fromhex(key.public_key)).signed(manifest, signature):
            wrong = f"the signature is not that of key {key.name} ({key.key_id}) for this bundle"
            raise ToktError(f"{where}: {wrong}; one of them was changed or exchanged")
        return key.key_id

    def to_text(self) -> str:
        """The keys file."""
        events = [asdict(event) for event in self.events]
        return json.dumps({"format_version": FORMAT_VERSION, "events": events}, indent=2) + "\n"


def trusted_keys_from_bytes(data: bytes, where: str) -> TrustedKeys:
    """Read a keys file.

    Raises DamagedKeysError if anything in it is not as tokt writes it; ToktError if a newer tokt
    wrote it.
    """
    damaged = DamagedKeysError(f"{where} is damaged: the store takes no bundle")
    try:
        value = printable_json(data)
        check_format(value["format_version"], FORMAT_VERSION, where)
        events = tuple(KeyEvent(**item) for item in value["events"])
    except (ValueError, TypeError, KeyError, RecursionError):
        raise damaged from None
    if set(value) != {"format_version", "events"} or not events or not _sound(events):
        raise damaged
    return TrustedKeys(events)


def _sound(events: Sequence[KeyEvent]) -> bool:
    """Whether people can have done this in this order, with the keys that it names."""
    known: set[str] = set()
    for event in events:
        if any(type(getattr(event, item.name)) is not str for item in fields(KeyEvent)):
            return False
        if event.action == TRUST and _is_key(event):
            known.add(event.key_id)
        elif event.action == DISTRUST and event.key_id in known and not event.public_key:
            known.remove(event.key_id)
        elif event.action == ACCEPT_UNSIGNED and not (event.key_id or event.public_key):
            known.clear()
        else:
            return False
    return True


def _is_key(event: KeyEvent) -> bool:
    try:
        raw = bytes.fromhex(event.public_key)
    except ValueError:
        return False
    return len(raw) == PUBLIC_KEY_BYTES and PublicKey(raw).id == event.key_id


def keys_json(keys: TrustedKeys) -> dict[str, Any]:
    """What ``tokt store --json`` says of them."""
    return {
        "required": keys.required,
        "trusted": [asdict(event) for event in keys.trusted.values()],
        "events": [asdict(event) for event in keys.events],
    }
