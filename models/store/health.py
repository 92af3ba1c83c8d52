"""The contents of a deploy store and its health, for `tokt store` and `tokt doctor`."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError, counted
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.signing.trusted_keys import TrustedKeys, keys_json

from .last_good import load_running
from .store import Store

Found = tuple[str, str, dict[str, Any]]
"""State, text and figures of a `Finding`."""


def store_summary(store: Store) -> dict[str, Any]:
    """What is active, where it comes from, whose signature it has, and all that has been.

    What cannot be read is left out, with a line in ``warnings``. ``starts_with`` is what a runtime
    that starts now takes, with ``instead`` in words if that is not the active model; or None.

    Raises ToktError if the store is not there or a newer tokt has written to it.
    """
    store.check_folder()
    reading = store.read()
    warnings = reading.damage
    keys = bundle = None
    try:
        keys = store.trusted_keys()
    except ToktError as error:
        warnings.append(str(error))
    try:
        bundle = None if reading.active is None else store.runnable(reading.active.sha256)
    except ToktError as error:
        warnings.append(f"the active model cannot be used: {error}")
    return {
        "active": None if reading.active is None else reading.active.to_json(),
        "signature": None if bundle is None else _signature(bundle, keys),
        "provenance": None if bundle is None else dict(bundle.provenance),
        "starts_with": _starts_with(store) if bundle is None else _named(bundle),
        "history": [entry.to_json() for entry in reading.entries],
        "keys": None if keys is None else keys_json(keys),
        "warnings": warnings,
    }


def _starts_with(store: Store) -> dict[str, str] | None:
    try:
        bundle, notes = load_running(store)
    except ToktError:
        return None
    return _named(bundle, notes[-1] if notes else "")


def _named(bundle: Bundle, instead: str = "") -> dict[str, str]:
    return {"label": bundle.label, "sha256": bundle.sha256, "instead": instead}


def _signature(bundle: Bundle, keys: TrustedKeys | None) -> dict[str, Any] | None:
    """Who is said to have signed it; checked only where the store asks for a signature."""
    if bundle.signature is None:
        return None
    return {"key_id": bundle.signature.key_id, "checked": keys is not None and keys.required}


def store_findings(path: Path) -> Iterator[Finding]:
    """Examine a store without writing to it."""
    if not path.is_dir():
        what = "is not a folder" if path.exists() else "does not exist"
        yield Finding("store", FAULT, f"{path} {what}")
        return
    store = Store(path)
    for name, look in _LOOKS.items():
        try:
            yield Finding(name, *look(store))
        except ToktError as error:
            yield Finding(name, FAULT, str(error))
    leftovers = [file for where in ("", "versions/*/") for file in path.glob(f"{where}.partial-*")]
    if leftovers:
        text = f"{len(leftovers)} half-written by a command that was killed, or is running now"
        yield Finding("store partial files", NOTE, text, {"files": len(leftovers)})


def _history(store: Store) -> Found:
    return OK, f"{store.path}: {counted(len(store.history()), 'activation')}", {}


def _active(store: Store) -> Found:
    try:
        entry = store.active_entry()
        if entry is None:
            if store.read().entries:
                raise ToktError(f"store {store.path}: the active pointer is gone")
            return NOTE, "none; deploy a model first", {}
        start = time.perf_counter()
        bundle = store.active()
        seconds = time.perf_counter() - start
    except ToktError as error:
        return FAULT, f"{error}; {_next_start(store)}", {}
    took = f"loaded and golden values recomputed in {seconds * 1000:.0f} ms"
    text = f"{bundle.label} since {entry.time}, {took}"
    figures = {"model": bundle.label, "sha256": bundle.sha256, "load_s": round(seconds, 4)}
    return OK, text, figures


def _keys(store: Store) -> Found:
    keys = store.trusted_keys()
    trusted = keys.trusted
    figures = {"required": keys.required, "trusted": list(trusted)}
    if not keys.required:
        text = "none; it takes any sound bundle, from whomever (docs/how-to/deploy.md)"
        return NOTE if keys.events else OK, text, figures
    if not trusted:
        return FAULT, "it trusts no key any more, and so takes no bundle", figures
    named = ", ".join(f"{event.name} {key}" for key, event in trusted.items())
    return OK, f"it takes only what these signed: {named}", figures


def _next_start(store: Store) -> str:
    """What a runtime that starts now would do without the active model."""
    starts = _starts_with(store)
    does = " has no model to run" if starts is None else f": {starts['instead']}"
    return f"a runtime that starts now{does}"


def _last_good(store: Store) -> Found:
    """The copy that a runtime kept; without one the earlier versions are what is left."""
    file = store.last_good_file
    if not file.exists():
        return OK, "none; a runtime that may write here keeps one", {}
    try:
        bundle = read_bundle(file)
        store.trusted_keys().check(bundle.data, f"bundle {file}")
        refusal = store.rollback_stack().refusal(bundle.sha256)
    except ToktError as error:
        return NOTE, f"cannot be used: {error}", {}
    figures = {"model": bundle.label, "sha256": bundle.sha256, "usable": not refusal}
    if refusal:
        return NOTE, f"{bundle.label} will not be used: {refusal}", figures
    return OK, f"{bundle.label}, verified", figures


def _versions(store: Store) -> Found:
    folders = sorted(folder for folder in store.path.glob("versions/*") if folder.is_dir())
    faults: list[str] = []
    unsigned: list[str] = []
    for folder in folders:
        try:
            bundle = _version(folder)
        except ToktError as error:
            faults.append(str(error))
            continue
        try:
            store.trusted_keys().check(bundle.data, bundle.label)
        except ToktError:
            unsigned.append(bundle.label)
    figures = {"versions": len(folders), "faults": faults, "unsigned": unsigned}
    if faults:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        return FAULT, f"{len(faults)} of {len(folders)} cannot be used: {faults[0]}{more}", figures
    verified = ", every one verified" if folders else ""
    text = f"{counted(len(folders), 'bundle')}{verified}"
    if unsigned:
        text += f"; without a signature asked for, and refused: {', '.join(unsigned)}"
    return NOTE if unsigned else OK, text, figures


def _version(folder: Path) -> Bundle:
    """One kept bundle; a version is a folder named by its bundle's hash."""
    file = folder / "bundle.tokt"
    bundle = read_bundle(file)
    if bundle.sha256 != folder.name:
        raise ToktError(f"bundle {file}: the file is not the one that was deployed")
    return bundle


_LOOKS: dict[str, Callable[[Store], Found]] = {
    "store": _history,
    "store active": _active,
    "store keys": _keys,
    "store last good copy": _last_good,
    "store versions": _versions,
}
"""What a store is examined for; one that raises ToktError has a fault."""
