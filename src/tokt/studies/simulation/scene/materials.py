"""Materials and textures of the surfaces of a world, in flat arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .tower import TEXEL_M, Material

Single = NDArray[np.float32]
Index = NDArray[np.int64]
Texture = tuple[NDArray[np.float32], ...]
"""Levels of (size, size, 2) brightness and rust, each at half the detail of the one before."""

_LEVELS = 5


@dataclass(frozen=True, eq=False)
class Materials:
    """Materials with their textures, by number; 0 has no texture.

    Attributes
    ----------
    paint, rust : (3, n_materials) float32
        Albedo of the paint, and what full rust adds to it.
    texture : (n_materials,) int64
        Number of the material's texture.
    texels : (all, 2) float32
        Every level of every texture, row by row.
    first, size : (textures, levels) int64
        A level's first texel, and texels along its side.
    """

    paint: Single
    rust: Single
    texture: Index
    texels: Single
    first: Index
    size: Index

    @classmethod
    def of(
        cls, materials: Sequence[tuple[Material, int]], textures: Sequence[Texture]
    ) -> Materials:
        """Materials each with its texture's number."""
        paint = np.array([material.paint for material, _ in materials], np.float64)
        rust = np.array([material.rust for material, _ in materials], np.float64)
        rusted = np.array([material.rusted for material, _ in materials], np.float64)
        levels = [level for texture in textures for level in texture]
        counts = [len(level) ** 2 for level in levels]
        shape = (len(textures), _LEVELS)
        return cls(
            np.ascontiguousarray(paint.T, np.float32),
            np.ascontiguousarray(((rust - paint) * rusted[:, None]).T, np.float32),
            np.array([texture for _, texture in materials], np.int64),
            np.concatenate([level.reshape(-1, 2) for level in levels]),
            np.concatenate([[0], np.cumsum(counts[:-1])]).reshape(shape).astype(np.int64),
            np.array([len(level) for level in levels], np.int64).reshape(shape),
        )

    def look_up(
        self, material_number: Index, across: Single, along: Single, pixel_m: Single
    ) -> tuple[Single, Single]:
        """Brightness and rust at surface coordinates.

        Parameters
        ----------
        material_number : (n,) int64
        across, along : (n,) float32
            Surface coordinates, m.
        pixel_m : (n,) float32
            Size of a camera's pixel on the surface: which level is read.
        """
        level = (np.frexp(pixel_m * np.float32(1 / TEXEL_M))[1] - 1).clip(0, _LEVELS - 1)
        texel = np.ldexp(np.float32(1 / TEXEL_M), -level)
        which = self.texture.take(material_number) * _LEVELS + level
        inside = self.size.take(which) - 1
        column = np.floor(across * texel).astype(np.int64) & inside
        row = np.floor(along * texel).astype(np.int64) & inside
        row *= inside + 1
        row += column
        row += self.first.take(which)
        found = self.texels.take(row, axis=0)
        return found[:, 0], found[:, 1].copy()
