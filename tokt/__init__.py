"""tokt: label, train, compare and deploy small texture models that keep an ROV off obstacles."""

from importlib.metadata import version

__version__ = version("tokt")
