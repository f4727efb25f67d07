"""The limit of buckling: the foundation that a lattice needs as a function of its spacing or of the exponent of its law."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from tqdm import tqdm

from ..interactions.pair_laws import InversePower
from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.linear_system import LinearSystem
from .buckling import softest_of

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

STEPS = 12
"""Number of wavevectors along each reciprocal vector; the softest wave between them is found too, see `softest`."""
EXACT = 1e-9
"""Width of the interval within which an exponent is found."""


@dataclass(frozen=True)
class Border:
    """Smallest foundation stiffness that holds a lattice, at several values of one parameter.

    Attributes
    ----------
    over : {'spacing', 'exponent'}
        The parameter; the spacing is a multiple of that of the reference.
    at, needed : ndarray, shape (values,)
        Its values, ascending, and the stiffness needed in N/mm, zero where the lattice is stable without a foundation.
    """

    over: Literal['spacing', 'exponent']
    at: np.ndarray
    needed: np.ndarray


def border_over_spacings(atoms: Atoms, scales: ArrayLike) -> Border:
    """The foundation needed if all bonds are stretched by the same factor.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion, in balance.
    scales : array_like, shape (values,)
        Multiples of the present spacing, ascending.

    Returns
    -------
    Border

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stability import border_over_spacings
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> border_over_spacings(cell, [1.0, 2.0]).needed.round(9).tolist()  # 4 f/L
    [4.0, 0.125]
    """
    system, scales = LinearSystem.of(atoms), np.asarray(scales, dtype=float)
    needed = np.array([softest_of(system, scale=scale, steps=STEPS).needed for scale in _shown(scales, 'spacings')])
    return Border('spacing', scales, needed)


def border_over_exponents(atoms: Atoms, exponents: ArrayLike) -> Border:
    """The foundation needed with other exponents of an inverse power that has the same force at the shortest bond.

    The exponents at which the lattice ceases to need a foundation are found, too, and added to `at`: there `needed` has a kink.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion by `InversePower`, in balance by its symmetry.
    exponents : array_like, shape (values,)
        Ascending.

    Returns
    -------
    Border

    Raises
    ------
    ValueError
        If the law is no inverse power.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stability import border_over_exponents
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> border = border_over_exponents(cell, [2.0, 4.0])
    >>> border.at.round(6).tolist(), border.needed.round(6).tolist()  # 2 (3 - a) f/L
    ([2.0, 3.0, 4.0], [2.0, 0.0, 0.0])
    """
    law, system = atoms.calc.law, LinearSystem.of(atoms)
    if not isinstance(law, InversePower):
        raise ValueError(f'{law!r} has no exponent to change; it must be an InversePower')
    bonds = system.calc.bonds
    shortest = bonds.lengths.min()
    force = -law.dphi(shortest)

    def needed(a):
        calc = MagneticRepulsion(system.atoms, InversePower(force * shortest**a, a), bonds=bonds)
        return softest_of(LinearSystem.about(calc, system.atoms), steps=STEPS).needed

    found: dict[float, float] = {float(a): needed(float(a)) for a in _shown(np.asarray(exponents, dtype=float), 'exponents')}
    for low, high in pairwise(list(found)):
        if (found[low] > 0) != (found[high] > 0):
            found[_change(lambda a: needed(a) > 0, low, high)] = 0.0
    at: NDArray[np.float64] = np.array(sorted(found))
    return Border('exponent', at, np.array([found[a] for a in at.tolist()]))


def _shown(values, what):
    """The values, with a progress bar on a terminal after two seconds."""
    return tqdm(values, desc=what, delay=2, disable=None, leave=False)


def _change(holds, low, high):
    """The point between `low` and `high` where `holds` changes; it must differ at the two ends."""
    first = holds(low)
    while high - low > EXACT:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) == first else (low, middle)
    return (low + high) / 2
