"""Requested cell sizes and types of a shape, sizes of cells along a line, and gmsh, which is imported on first use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Self, TypedDict, get_type_hints

import numpy as np

from forms.base import InputError, import_optional, is_finite, require
from geometry.refusals import require_known, unknown_name_message
from geometry.topology import FloatArray

CELL_TYPES_OF_DIM = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}
DEFAULT_CELLS_ACROSS = {2: 10, 3: 5}  # default number of cells across the thinnest part, by dimension
ARRANGEMENTS = ("Left", "Right", "AlternateLeft", "AlternateRight")
COUNT_DECIMALS = 9  # decimals to which numbers of cells are rounded, so that they do not depend on the unit of length
MIN_LENGTH_RATIO = 1e-6  # least length of a shape over its largest: gmsh merges points closer than 1e-8
MIN_SIZE_RATIO = 1e-5  # smallest cell size allowed, over the size of the shape


class _Gmsh:
    """Stand-in for the module gmsh, which imports it on first use.

    The import takes a third of a second, and only one rank needs it.
    """

    def __getattr__(self, name: str) -> Any:
        return getattr(import_optional("gmsh"), name)


gmsh = _Gmsh()


class SizeArgs(TypedDict, total=False):
    """Keyword arguments of builders for cell sizes.

    Attributes:
        h_S: cell size at S, a length; None: the default.
        h_ends: cell size at the ends of S, a length; None: the default.
    """

    h_S: float | None
    h_ends: float | None


class GridArgs(SizeArgs, total=False):
    """Keyword arguments of builders for the cells of boxes, in addition to those of `SizeArgs`.

    Attributes:
        cell: type of the cells; None for the default.
        structured: whether triangles or tetrahedra divide the cells of a grid.
        arrangement: which diagonals halve a grid's rectangles in the x-y plane: "Right", "Left", "AlternateRight" or
            "AlternateLeft", as in `block`.
    """

    cell: str | None
    structured: bool
    arrangement: str


class CurvedArgs(SizeArgs, total=False):
    """Keyword arguments of builders for the cells of round shapes, in addition to those of `SizeArgs`.

    Attributes:
        cell: type of the cells; None for the default.
        degree: polynomial degree of the cells' geometry, 1 (straight) or 2 (curved).
    """

    cell: str | None
    degree: int


def scaled_length(length: float, factor: float) -> float:
    """Return `length` * `factor`, rounded to 15 significant digits; with the factor 1, return `length` unchanged."""
    return length if factor == 1 else float(f"{length * factor:.15g}")


def require_width(part_name: str, width: float, largest: float) -> None:
    """Raise InputError if a part of a shape is so thin that gmsh could merge points on its two sides.

    The least width is 1e-6 of the shape's largest length.

    Args:
        part_name: name of the part, for the message.
        width: its width, a length.
        largest: largest length of the shape.
    """
    if width < (least := MIN_LENGTH_RATIO * largest):
        allowed = f"at least {least:g} ({MIN_LENGTH_RATIO:g} of the largest length)"
        raise InputError(f"{part_name} is {width:g}; allowed: {allowed}")


class MeshOptions(NamedTuple):
    """Cell sizes, type and geometry that the user requests for a shape.

    Attributes:
        h, h_S, h_ends: largest cell size, cell size at S and at the ends of S, lengths; None for the default.
        cell: "triangle", "quadrilateral", "tetrahedron" or "hexahedron"; None: the shape's default.
        degree: degree of the cells' geometry, 1 (straight) or 2 (curved).
        structured: whether triangles or tetrahedra divide the cells of a grid.
        arrangement: which diagonals halve a grid's rectangles in the x-y plane: "Right", "Left", "AlternateRight" or
            "AlternateLeft", as in `block`.
    """

    h: float | None
    h_S: float | None = None
    h_ends: float | None = None
    cell: str | None = None
    degree: int = 1
    structured: bool = False
    arrangement: str = "Right"

    @classmethod
    def of(cls, h: float | None, options: SizeArgs, allowed: type[SizeArgs]) -> Self:
        """Return the options from the keyword arguments of a builder such as `block`.

        Args:
            h: largest cell size, a length; None for the default.
            options: the keyword arguments.
            allowed: class whose attributes are the keywords that the builder allows.

        Raises:
            InputError: a keyword is not allowed.
        """
        for name in options.keys() - (keywords := get_type_hints(allowed)):
            raise InputError(unknown_name_message("keyword", name, keywords))
        return cls(h, **options)

    def check(self, lengths: Mapping[str, float], dim: int) -> None:
        """Raise InputError if a length of the shape is not > 0, or if the options do not suit its lengths or dimension.

        Args:
            lengths: name of a length in messages -> length of the shape.
            dim: number of dimensions, 2 or 3.
        """
        for argument, value in lengths.items():
            require(is_finite(value) and value > 0, argument, value, "it must be > 0")
        largest = max(lengths.values())
        for argument, value in lengths.items():
            require_width(argument, value, largest)
        smallest = MIN_SIZE_RATIO * largest
        for argument, size in {"h": self.h, "h_S": self.h_S, "h_ends": self.h_ends}.items():
            is_allowed = size is None or (is_finite(size) and smallest <= size <= largest)
            require(is_allowed, f"cell size {argument}", size, f"allowed: {smallest:g} to {largest:g}")
        if self.cell is not None:
            require_known(f"cell in {dim}D", self.cell, CELL_TYPES_OF_DIM[dim])
        require(is_finite(self.degree) and self.degree in (1, 2), "degree", self.degree, "allowed: 1, 2 (curved cells)")
        require_known("arrangement", self.arrangement, ARRANGEMENTS)

    def scaled(self, factor: float) -> MeshOptions:
        """Return the options with all cell sizes multiplied by `factor`."""
        h, h_S, h_ends = (size and scaled_length(size, factor) for size in (self.h, self.h_S, self.h_ends))
        return self._replace(h=h, h_S=h_S, h_ends=h_ends)


class Grading(NamedTuple):
    """Sizes of the cells along a line: a geometric series from one end to the other, or from both ends to the middle.

    Attributes:
        n: number of cells.
        first, last: sizes of the first and of the last cell, lengths; if symmetric, of cells at the ends and in the
            middle.
        symmetric: whether sizes change from both ends to the middle.
        backwards: whether the first cell lies at the end of the line, not at its beginning.
    """

    n: int
    first: float
    last: float
    symmetric: bool = False
    backwards: bool = False

    @classmethod
    def of(cls, length: float, first: float, last: float, *, symmetric: bool = False, backwards: bool = False) -> Self:
        """Return the geometric series of cells on a line that comes closest to two cell sizes.

        Args:
            length: length of the line.
            first, last: sizes of the first and of the last cell, lengths; if symmetric, of cells at the ends and in the
                middle.
            symmetric: whether sizes change from both ends to the middle.
            backwards: whether the first cell lies at the end of the line, not at its beginning.
        """
        if first == last:
            return cls(max(1, round(round(length / first, COUNT_DECIMALS))), first, last, symmetric, backwards)
        span = length / 2 if symmetric else length
        if max(first, last) >= span:
            first, last = min(first, span / 2), min(last, span / 2)
        ratio = last / first
        n = 2 if ratio == 1 else max(2, round(1 + np.log(ratio) / np.log((span - first) / (span - last))))
        return cls(2 * n if symmetric else n, first, last, symmetric, backwards)

    @property
    def growth(self) -> float:
        """Ratio of the size of each cell to that of the cell before it, counted from the first cell."""
        steps = (self.n // 2 if self.symmetric else self.n) - 1
        return float((self.last / self.first) ** (1 / steps)) if self.first != self.last else 1.0

    @property
    def cell_ends(self) -> list[float]:
        """End of each cell along the line, as increasing fractions of the line's length; the last is 1."""
        k = np.arange(self.n)
        sizes = self.growth ** (np.minimum(k, k[::-1]) if self.symmetric else k[::-1] if self.backwards else k)
        return [*(np.cumsum(sizes) / sizes.sum())[:-1].tolist(), 1.0]

    def positions(self, length: float) -> FloatArray:
        """Return (n + 1,) positions of the ends of the n cells along a line of this `length`, from 0 to `length`."""
        return length * np.array([0.0, *self.cell_ends])

    def set_on_curve(self, curve: int) -> None:
        """Prescribe these cells on the curve of the current gmsh model that has the tag `curve`."""
        progression = ("Progression", 1 / self.growth if self.backwards else self.growth)
        if self.symmetric and self.first != self.last:
            progression = ("Bump", self.first / self.last)
        gmsh.model.mesh.setTransfiniteCurve(curve, self.n + 1, *progression)
