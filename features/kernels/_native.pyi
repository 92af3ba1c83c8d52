"""Types of the compiled extension (features/kernels/native/kernels.pyx)."""

import numpy as np
from numpy.typing import NDArray

INTERFACE: int
INSTRUCTIONS: tuple[str, ...]

def use_instructions(name: str) -> None: ...

class LbpTables:
    def __init__(
        self,
        reach: int,
        first: NDArray[np.int32],
        point: NDArray[np.int32],
        row_floor: NDArray[np.int32],
        row_fraction: NDArray[np.float64],
        column_floor: NDArray[np.int32],
        column_fraction: NDArray[np.float64],
        code: NDArray[np.uint8] | None,
    ) -> None: ...
    def scratch_size(self, patch_height: int, patch_width: int) -> int: ...
    def count_rows(
        self,
        gray: NDArray[np.uint8],
        cols: int,
        patch_height: int,
        patch_width: int,
        across_patches: bool,
        first: int,
        last: int,
        scratch: NDArray[np.float64],
        counts: NDArray[np.int64],
    ) -> None: ...

class GlcmScratch:
    def __init__(
        self,
        counts: NDArray[np.uint32],
        cells: NDArray[np.uint16],
        sums: NDArray[np.int64],
        keys: NDArray[np.uint16],
    ) -> None: ...
    @staticmethod
    def sums_size() -> int: ...
    def describe_rows(
        self,
        gray: NDArray[np.uint8],
        cols: int,
        patch_height: int,
        patch_width: int,
        ignore_zeros: bool,
        first: int,
        last: int,
        log2_of: NDArray[np.float64],
        inverse_difference: NDArray[np.float64],
        features: NDArray[np.float64],
    ) -> None: ...

class AreaTables:
    def __init__(
        self, first: NDArray[np.int32], source: NDArray[np.int32], weight: NDArray[np.float32]
    ) -> None: ...

def area_scratch_size(frame: NDArray[np.uint8], width: int) -> int: ...
def area_gray(
    frame: NDArray[np.uint8],
    rows: AreaTables,
    columns: AreaTables,
    first: int,
    last: int,
    near_tie: float,
    scratch: NDArray[np.float32],
    out: NDArray[np.uint8],
) -> None: ...

class Gray16Tables:
    def __init__(
        self, first: NDArray[np.int32], source: NDArray[np.int32], weight: NDArray[np.int32]
    ) -> None: ...

def gray16_scratch_size(frame: NDArray[np.uint8], width: int) -> int: ...
def resized_gray16(
    frame: NDArray[np.uint8],
    rows: Gray16Tables,
    columns: Gray16Tables,
    first: int,
    last: int,
    step: float,
    scratch: NDArray[np.int32],
    out: NDArray[np.uint16],
) -> None: ...
def gray16_total(gray16: NDArray[np.uint16]) -> int: ...

class Quantizer:
    def __init__(
        self,
        smooth: int,
        window: int,
        ratio: bool,
        ratio_of: float,
        min_around: float,
        offset: float,
        top: float,
    ) -> None: ...
    def scratch_size(self, width: int) -> int: ...
    def rows(
        self,
        gray16: NDArray[np.uint16],
        scale: float,
        first: int,
        last: int,
        scratch: NDArray[np.float64],
        out: NDArray[np.uint8],
    ) -> None: ...

def level_counts(
    gray: NDArray[np.uint8],
    cols: int,
    patch_height: int,
    patch_width: int,
    first: int,
    last: int,
    counts: NDArray[np.int64],
) -> None: ...
def structure_scratch_size(gray: NDArray[np.uint8]) -> int: ...
def structure_sums(
    gray: NDArray[np.uint8],
    cols: int,
    patch_height: int,
    patch_width: int,
    first: int,
    last: int,
    scratch: NDArray[np.int32],
    sums: NDArray[np.int64],
) -> None: ...
def lines_scratch_size(
    gray: NDArray[np.uint8], patch_height: int, samples: NDArray[np.int32]
) -> int: ...
def line_sums(
    gray: NDArray[np.uint8],
    cols: int,
    patch_height: int,
    patch_width: int,
    middle: int,
    samples: NDArray[np.int32],
    first: int,
    last: int,
    scratch: NDArray[np.int16],
    sums: NDArray[np.int64],
) -> None: ...
def nearest_scratch_size(
    gray: NDArray[np.uint8],
    patch_height: int,
    patch_width: int,
    moves: NDArray[np.int32],
    reach: int,
    across_patches: bool,
) -> int: ...
def nearest_counts(
    gray: NDArray[np.uint8],
    cols: int,
    patch_height: int,
    patch_width: int,
    moves: NDArray[np.int32],
    reach: int,
    across_patches: bool,
    first: int,
    last: int,
    scratch: NDArray[np.uint8],
    counts: NDArray[np.int64],
) -> None: ...

class MatchKernel:
    def __init__(
        self, smallest: int, count: int, block: int, zero: int, texture: int, uniqueness: int
    ) -> None: ...
    def scratch_size(self, width: int) -> int: ...
    def disparities(
        self,
        left: NDArray[np.uint8],
        right: NDArray[np.uint8],
        wanted: NDArray[np.uint8],
        top: int,
        bottom: int,
        first: int,
        last: int,
        scratch: NDArray[np.uint16],
        out: NDArray[np.int16],
    ) -> None: ...
