"""A disk budget: the most that a folder may hold, and the reserve it leaves free on its disk."""

from __future__ import annotations

import math
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from tokt.features.common.errors import ToktError

BLOCK_BYTES = 4096
_MARGIN_BYTES = 8 * BLOCK_BYTES
"""For what is not counted one by one: the heads of files of lines, and their last blocks."""


@dataclass(frozen=True)
class DiskLimits:
    """Bounds in megabytes (10^6 bytes).

    Parameters
    ----------
    most_mb : float
        What the folder's files come to at most, in whole blocks of 4 KiB.
    reserve_mb : float
        What stays free on its disk.

    Raises
    ------
    ToktError
        If one is not a size.
    """

    most_mb: float
    reserve_mb: float

    def __post_init__(self) -> None:
        if not 0 < self.most_mb < math.inf or not 0 <= self.reserve_mb < math.inf:
            raise ToktError(f"{self.most_mb:g} MB with {self.reserve_mb:g} MB to spare is no limit")


class DiskBudget:
    """Keep count of a folder that one process writes to.

    Parameters
    ----------
    folder : Path
    limits : DiskLimits

    Attributes
    ----------
    used_bytes : int
    most_bytes : float
    """

    def __init__(self, folder: Path, limits: DiskLimits) -> None:
        self._folder = folder
        self._limits = limits
        self.most_bytes = 1e6 * limits.most_mb
        self.used_bytes = 0
        self.count()

    def count(self) -> None:
        """Look at the disk: somebody may have taken something away."""
        self.used_bytes = _size_of(self._folder)

    def lacking(self, size: int) -> float:
        """Bytes that have to go before so many more fit; 0 or less if they do."""
        return self.used_bytes + size + _MARGIN_BYTES - self.most_bytes

    def keeps_reserve(self, size: int) -> bool:
        """Whether the disk has its reserve after so many more bytes.

        Raises
        ------
        OSError
            If the folder is gone.
        """
        return shutil.disk_usage(self._folder).free - size >= 1e6 * self._limits.reserve_mb


def whole_blocks(size: int) -> int:
    """Bytes that a file of this size takes of the disk."""
    return -(-size // BLOCK_BYTES) * BLOCK_BYTES


def _size_of(folder: Path) -> int:
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            try:
                total += whole_blocks((Path(place) / name).stat().st_size)
            except OSError:
                continue  # taken away meanwhile
    return total
