"""Loading a model by any name a command takes; a bundle file needs no registry."""

from pathlib import Path
from typing import Any

from tokt.models.bundle.bundle import SUFFIX, Bundle, read_bundle


def load_model(reference: str, workspace: Path, **checks: Any) -> Bundle:
    """The bundle behind a ``.tokt`` file, ``name``, ``name@alias`` or ``name/version``.

    `checks` are those of `Registry.bundle`; a file was checked by whoever exported it.

    Raises ToktError if there is none, or it fails a check.
    """
    if reference.endswith(SUFFIX):
        return read_bundle(reference)
    from .registry import Registry

    return Registry(workspace).bundle(reference, **checks)
