"""Names of the models that come with tokt."""

from pathlib import Path

from tokt.features.common.errors import ToktError

WATERS = "waters"
"""Of many waters and cameras: a model to begin with (docs/explanation/waters.md)."""
NAMES = (WATERS,)


def packaged_bundle(name: str) -> Path:
    """Return the bundle file of a model that comes with tokt.

    Raises ToktError if none is called so.
    """
    if name not in NAMES:
        raise ToktError(f"no model {name!r} comes with tokt (there is {', '.join(NAMES)})")
    return Path(__file__).with_name(f"{name}.tokt")
