"""The compiled extension: its types stand in native/kernels.pyx, which checks each call by them."""

from typing import Any

INTERFACE: int
INSTRUCTIONS: tuple[str, ...]

def __getattr__(name: str) -> Any: ...
