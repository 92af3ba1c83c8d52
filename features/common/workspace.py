"""The folder in which tokt keeps its state: labels, datasets, registry, keys of pages."""

from pathlib import Path

DEFAULT_WORKSPACE = Path(".tokt")
