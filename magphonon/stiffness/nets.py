"""Nets of members: springs, bars and cables with their own rest lengths, and the forces with which they balance each other.

A net is a structure with a list of bonds, each with its own law. All tools accept it, because each node has its own kind, and
laws are given for pairs of kinds.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..errors import shown
from ..interactions.pair_laws import PairLaw
from .calculator import PairCalculator
from .repulsion import repulsion_of
from .rest import LinearSystem

BALANCED = 1e-10  # of the largest singular value: below it the tensions of a self-stress balance


def net(atoms: Atoms, members: Iterable[tuple[Any, ...]], **sites: Any) -> Atoms:
    """A structure whose nodes are joined by members, each with its own law.

    Parameters
    ----------
    atoms : ase.Atoms
        The nodes; their tags are replaced.  Nodes held by FixAtoms are supports.
    members : sequence of (i, j, law) or (i, j, shift, law)
        The nodes that a member joins, the periodic cell of j (default 0 0 0), and its law: `Spring`, `Cable` or any other.
    **sites
        What else `PairCalculator` takes: foundation, load, model, dim and so on.

    Returns
    -------
    ase.Atoms
        A copy with a PairCalculator.

    Raises
    ------
    ValueError
        If two members of different laws join the same two nodes (in a small cell: repeat it).

    Examples
    --------
    >>> from ase import Atoms
    >>> from magphonon.interactions import Spring
    >>> from magphonon.stiffness import net
    >>> pair = net(Atoms('H2', [[0, 0, 0], [10, 0, 0]], masses=[1, 1]), [(0, 1, Spring(2.0, 9.5))])
    >>> float(pair.get_forces()[0, 0])  # N: a spring of 2 N/mm, stretched by 0.5 mm, pulls the first node along x
    1.0
    """
    members, nodes = list(members), atoms.copy()
    nodes.set_tags(range(len(nodes)))
    laws: dict[tuple[int, int], PairLaw] = {}
    for member in members:
        try:
            i, j, *_, law = member
            i, j = operator.index(i), operator.index(j)
        except (TypeError, ValueError):
            raise ValueError(f'a member is (i, j, law) or (i, j, shift, law), as (0, 1, Spring(2.0, 9.5)), not '
                             f'{shown(member)}') from None
        if laws.setdefault((min(i, j), max(i, j)), law) != law:
            raise ValueError(f'two members of different laws join the nodes {i} and {j}; a pair of nodes has one law: repeat the '
                             'cell, or put a node between them')
    nodes.calc = PairCalculator(nodes, laws, bonds=[member[:-1] for member in members], **sites)
    return nodes


def self_stress(atoms: Atoms) -> NDArray[np.float64]:
    """The independent states of self-stress of a structure: tensions of its bonds that balance at every node without a load.

    Parameters
    ----------
    atoms : ase.Atoms
        With its PairCalculator; forces that supports and guides carry need not balance.

    Returns
    -------
    ndarray, shape (states, bonds)
        Tensions of the bonds in the order of `atoms.calc.bonds`. In each state the sum of squares is 1, and the sign is
        arbitrary.

    Examples
    --------
    >>> from magphonon import MagneticRepulsion, lattices
    >>> from magphonon.interactions import Spring
    >>> from magphonon.stiffness import self_stress
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, Spring(1.0, 0.9))
    >>> self_stress(cell).shape  # the two threads of a square net can be taut one without the other
    (2, 2)
    """
    calc = repulsion_of(atoms)
    bonds, n = calc.bonds, calc.bond_vectors / calc.bonds.lengths[:, None]
    pulls = np.stack([bonds.net(tension[:, None] * n).ravel() for tension in np.eye(len(bonds))], axis=1)
    balance = LinearSystem.about(calc, atoms).moving().free.T @ pulls
    _, size, states = np.linalg.svd(balance)
    return states[np.count_nonzero(size > BALANCED * size.max(initial=0.0)):]
