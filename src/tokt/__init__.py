"""tokt: label, train, compare and deploy small texture models that keep an ROV off obstacles."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
else:

    def __getattr__(name: str) -> str:
        """Look the version up when it is asked for: that takes a tenth of the runtime's start."""
        if name != "__version__":
            raise AttributeError(f"module 'tokt' has no attribute {name!r}")
        from importlib.metadata import version

        return version("tokt")
