"""The finite lattice that waves cross, as a table of a scene file: its shape and size, in SI.

Its rim is held, as in `magphonon.lattices`.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from . import lattices
from . import units as u
from .errors import one_of, shown
from .tables import Count, Length, Table

MOST_CELLS = 10**6
"""A patch of more needs gigabytes; rather than wanted it is a wrong unit."""


class PatchTable(Table):
    """What every shape does."""

    def cells(self, cell):
        """How many cells it has, about; none of a lattice without a plane."""
        return self.area(cell) / np.linalg.norm(np.cross(*cell.cell.array[:2])) if cell.pbc[1] else 0

    def cut(self, cell):
        """The patch, `ase.Atoms` without calculator.

        Raises
        ------
        ValueError
            If it is too large to compute with or too small to have an inside, or the lattice has no plane.
        """
        cells = self.cells(cell)
        if cells > MOST_CELLS:
            raise ValueError(f'the patch of {cells:.2g} cells is too large (at most {MOST_CELLS:g}); make it smaller, '
                             'and check its unit and that of lattice.spacing_m')
        return self.shape(cell)


class Parallelogram(PatchTable):
    """Whole cells along both lattice vectors."""

    size_key: ClassVar = 'patch.cells_1'

    kind: Literal['parallelogram']
    cells_1: Count = Field(description='the number of cells along the first lattice vector')
    cells_2: Count = Field(description='the number of cells along the second lattice vector')

    def area(self, cell):
        return self.cells_1 * self.cells_2 * np.linalg.norm(np.cross(*cell.cell.array[:2]))

    def shape(self, cell):
        return lattices.parallelogram(cell, self.cells_1, self.cells_2)


class Rectangle(PatchTable):
    """Upright rectangle."""

    size_key: ClassVar = 'patch.width_m'

    kind: Literal['rectangle']
    width_m: Length = Field(description='the width in m, along x')
    height_m: Length = Field(description='the height in m, along y')

    def area(self, cell):
        return self.width_m * u.m * self.height_m * u.m

    def shape(self, cell):
        return lattices.rectangle(cell, self.width_m * u.m, self.height_m * u.m)


class Hexagon(PatchTable):
    """Regular hexagon with corners on the x axis, or its upper half, as in the paper's experiment."""

    size_key: ClassVar = 'patch.side_m'

    kind: Literal['hexagon', 'half_hexagon']
    side_m: Length = Field(description='the side of the hexagon in m')

    def area(self, cell):
        return 1.5 * np.sqrt(3) * (self.side_m * u.m) ** 2 * (1 if self.kind == 'hexagon' else 1 / 2)

    def shape(self, cell):
        return getattr(lattices, self.kind)(cell, self.side_m * u.m)


PATCHES = ('parallelogram', 'rectangle', 'hexagon', 'half_hexagon')


def _known_patch(table):
    if not isinstance(table, dict) or 'kind' not in table:
        raise ValueError(f' must be a table [patch] with a kind, one of {", ".join(PATCHES)}, not {shown(table)}')
    one_of('.kind', table['kind'], PATCHES)
    return table


Patch = Annotated[Parallelogram | Rectangle | Hexagon, Field(discriminator='kind'), BeforeValidator(_known_patch)]
