"""Stores that a registered version was deployed to, as far as they can still be read."""

from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.models.store.store import Store

from .registration import RegisteredVersion


def deployments(version: RegisteredVersion) -> list[dict[str, Any]]:
    """Return the last deployment to each store, with what is active there now.

    Parameters
    ----------
    version : RegisteredVersion

    Returns
    -------
    list of dict
        store, time, who, why, sha256, active (None where the store cannot be read) and words.
    """
    try:
        records = {str(record["store"]): record for record in version.deployments}
        return [_with_state(store, record) for store, record in records.items()]
    except (ToktError, KeyError) as error:
        damaged = f"where it was deployed is not known: {error}"
        return [{"store": None, "active": None, "words": damaged}]


def _with_state(store: str, record: dict[str, Any]) -> dict[str, Any]:
    active, now = None, "that store cannot be read now"
    try:
        entry = Store(store).read().active if Path(store).is_dir() else None
        if entry is not None:
            active = entry.sha256 == record["sha256"]
            now = "active there" if active else f"not active there: {entry.label} is"
    except (ToktError, OSError):
        pass  # as for one that is gone
    words = f"deployed to {store} on {str(record['time'])[:10]}, {now}"
    return {**record, "active": active, "words": words}
