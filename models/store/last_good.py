"""The model a runtime starts with: the active one, or if that cannot be used, the last good one.

While the runtime works it keeps a copy of the bundle it uses in the store, apart from the kept
versions. When the active bundle no longer passes its checks after a crash or a power cut, or the
pointer to it cannot be read, the next start goes on with what is left, in this order:

1. the active model, as the pointer or, if that is damaged, its copy names it;
2. the copy of the bundle that the runtime used last;
3. the models that rolling back would go to, newest first.

Each passes all checks again: hashes, the signatures that the store asks for now, golden values. A
model that a person rolled back from is never taken, not even from the copy; nor is one of which
the history, where it is damaged, does not say that nobody did.
"""

import hashlib
from collections.abc import Callable, Iterator

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError, os_words
from tokt.models.bundle.bundle import Bundle, bundle_file_bytes, bundle_from_bytes

from .history import Activation, DamagedError
from .store import Store

Candidate = tuple[str, Callable[[], Bundle]]
"""What it is, in words, and how to load it."""


def remember_good(store: Store, bundle: Bundle) -> str:
    """Keep a copy of the bundle in use, for the next start.

    The bundle is from this store and has passed every check. It waits for the disk: not to be
    called between two frames. Returns why it could not be kept for certain, such as a store
    that this account may only read; or an empty string.
    """
    file = store.last_good_file
    try:
        if not file.is_file() or file.read_bytes() != bundle.data:
            atomic.write_bytes(file, bundle.data)
    except OSError as error:
        kept = "the" if isinstance(error, atomic.NotDurableError) else "no"
        what = f"{kept} copy of {bundle.label} is kept for the next start"
        return f"store {store.path}: {what}: {os_words(error)}"
    return ""


def load_running(store: Store) -> tuple[Bundle, list[str]]:
    """The bundle to start with, checked whole, and notes why it is not the active one.

    A note is a line for each that was refused and one for what runs instead; the active one has
    none.

    Raises ToktError if the store is not there, no model was ever activated, or none can be used:
    then with all that was refused.
    """
    store.check_folder()
    notes: list[str] = []
    for what, load in _candidates(store, notes):
        try:
            bundle = load()
        except ToktError as error:
            notes.append(f"{what} is refused: {error}")
            continue
        if notes:
            notes.append(f"{what} runs instead: {bundle.label}, sha256 {bundle.sha256[:12]}")
        return bundle, notes
    raise ToktError("; ".join(notes) or f"store {store.path} has no active model; deploy one first")


def _candidates(store: Store, notes: list[str]) -> Iterator[Candidate]:
    """What may run, best first; a later one is only looked for when those before it failed."""
    try:
        active = store.active_entry()
    except DamagedError as error:
        notes.append(str(error))
        active = None
    if active is not None:
        yield _kept(store, active, "the active model")
    try:
        stack = store.rollback_stack()
    except ToktError as error:  # what people rolled back from cannot be known
        notes.append(str(error))
        return
    if not stack.entries:
        return
    if active is None:
        if not notes:
            notes.append(f"store {store.path}: the active pointer is gone")
        yield _kept(store, stack.entries[-1], "the model that was active by the history")
    if store.last_good_file.exists():
        yield "the last good copy", lambda: last_good(store)
    for entry in reversed(stack.entries[:-1]):
        if not stack.refusal(entry.sha256):
            yield _kept(store, entry, "the earlier model")


def _kept(store: Store, entry: Activation, what: str) -> Candidate:
    return f"{what} ({entry.label})", lambda: store.runnable(entry.sha256)


def last_good(store: Store) -> Bundle:
    """The copy of what ran last, checked whole.

    Raises ToktError if there is none, it fails a check, or the history does not say that it was
    active and that nobody rolled back from it.
    """
    where = f"bundle {store.last_good_file}"
    data = bundle_file_bytes(store.last_good_file)
    refusal = store.rollback_stack().refusal(hashlib.sha256(data).hexdigest())
    if refusal:
        raise ToktError(f"{where}: {refusal}")
    store.trusted_keys().check(data, where)
    bundle = bundle_from_bytes(data, where)
    store.check_fit(bundle)
    return bundle
