"""The summary of a deploy store that ``tokt store`` shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle
from tokt.models.signing.trusted_keys import TrustedKeys, keys_json

from .history import Activation
from .last_good import load_running
from .store import Store

T = TypeVar("T")


def store_summary(store: Store) -> dict[str, Any]:
    """What is active, where it comes from, whose signature it has, and all that has been.

    What cannot be read is left out, with a line in ``warnings``. ``starts_with`` is what a runtime
    that starts now takes, with ``instead`` in words if that is not the active model; or None.

    Raises
    ------
    ToktError
        If the store is not there or a newer tokt has written to it.
    """
    store.check_folder()
    reading = store.read()
    warnings = reading.damage
    keys = _or_warn(store.trusted_keys, warnings, "")
    bundle = _active_bundle(store, reading.active, warnings)
    return {
        "active": None if reading.active is None else reading.active.to_json(),
        "signature": None if bundle is None else _signature(bundle, keys),
        "provenance": None if bundle is None else dict(bundle.content.provenance),
        "starts_with": _starts_with(store) if bundle is None else _named(bundle),
        "history": [entry.to_json() for entry in reading.entries],
        "keys": None if keys is None else keys_json(keys),
        "warnings": warnings,
    }


def _or_warn(make: Callable[[], T], warnings: list[str], what: str) -> T | None:
    try:
        return make()
    except ToktError as error:
        warnings.append(f"{what}{error}")
        return None


def _active_bundle(store: Store, active: Activation | None, warnings: list[str]) -> Bundle | None:
    if active is None:
        return None
    what = "the active model cannot be used: "
    return _or_warn(lambda: store.runnable(active.sha256), warnings, what)


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
    return {
        "key_id": bundle.signature.key_id,
        "checked": keys is not None and keys.required,
    }
