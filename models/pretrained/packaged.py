"""Names of the models that come with tokt."""

from pathlib import Path

from tokt.features.common.errors import ToktError

WATERS = "waters"
"""Of many waters and cameras: a model to begin with (docs/explanation/waters.md)."""
VERSIONS = {WATERS: "1"}
"""Of the models that come with tokt, by name."""


def is_packaged(reference: object) -> bool:
    """Return whether a model that comes with tokt is meant: by its name, or with its version."""
    name, _, version = str(reference).partition("/")
    return name in VERSIONS and version in ("", VERSIONS[name])


def packaged_bundle(reference: str) -> Path:
    """Return the bundle file of a model that comes with tokt.

    Raises ToktError if none is called so.
    """
    if not is_packaged(reference):
        raise ToktError(
            f"no model {reference!r} comes with tokt (there is {', '.join(VERSIONS)}). A bundle "
            "file goes with --bundle, a store with --store. tokt export makes a file of a "
            "registered model"
        )
    return Path(__file__).with_name(f"{reference.partition('/')[0]}.tokt")
