"""The tables [[members]] of a scene: the springs and cables of a net by the nodes that they join.

Their rest lengths are given, or follow from given tensions. Members with neither get the tension that balances the others, a
state of self-stress.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from ase import Atoms
from pydantic import BeforeValidator, Field, model_validator

from .. import units as u
from ..errors import shown, whole
from ..interactions.pair_laws import Cable, Spring
from ..stiffness.nets import net, self_stress
from ..stiffness.repulsion import repulsion_of
from .fields import Flag, Length, Number, Positive, Table, listed, within

UNBALANCED = 1e-6  # of the largest tension: larger forces that are left at nodes are no round-off of the positions in a file


def _joined(value):
    """Two nodes, counted from 0 as in the file, and the periodic cell of the second one: (i, j, (n1, n2, n3))."""
    if not isinstance(value, list) or not 2 <= len(value) <= 5:
        raise ValueError(' must be two nodes, as [0, 1], or in a periodic net two nodes and the cell of the second, as [0, 1, '
                         f'1, 0], not {shown(value)}')
    i, j = (whole(f'[{k}]', node, least=0) for k, node in enumerate(value[:2]))
    shift = [whole(f'[{k + 2}]', n, least=-1000) for k, n in enumerate(value[2:])]
    return i, j, (*shift, *[0] * (3 - len(shift)))


Joined = Annotated[tuple[int, int, tuple[int, int, int]], BeforeValidator(_joined)]


class Members(Table):
    """Members of one kind: springs, which push and pull, or cables."""

    between: Annotated[tuple[Joined, ...], listed] = Field(
        description='the two nodes of each member, counted from 0 in the order of the file; in a periodic net also the cell of '
        'the second node, as [0, 1, 1, 0]', examples=[[[0, 1], [1, 2], [2, 0]]])
    stiffness_N_per_m: Annotated[Positive, within(1e-15, 1e15, 'N/m')] = Field(
        description='the stiffness of a member in N/m', examples=[1000.0])
    rest_length_m: Length | None = Field(
        None, description='the length of a member without load in m; if tension_N is omitted too, the member gets the tension '
                          'that balances the others',
        examples=[0.09])
    tension_N: Annotated[Number, within(-1e12, 1e12, 'newtons')] | None = Field(
        None, description='the tension in N at the positions of the file, negative under compression; in place of rest_length_m',
        examples=[5.0])
    slack: Flag = Field(False, description='whether a member is a cable, which goes slack instead of pushing', examples=[True])

    @model_validator(mode='after')
    def _one_length(self):
        if self.rest_length_m is not None and self.tension_N is not None:
            raise ValueError(' has both rest_length_m and tension_N; keep one of them')
        return self

    def law_at(self, r: float, tension: float) -> Any:
        """The law of a member of length `r` in mm; if no rest length is given, its tension in N is `tension`."""
        k = self.stiffness_N_per_m * u.N / u.m
        L0 = r - tension / k if self.rest_length_m is None else self.rest_length_m * u.m
        if L0 < 0:
            raise ValueError(f'members: a tension of {tension:.3g} N stretches a member of stiffness_N_per_m = '
                             f'{self.stiffness_N_per_m!r} by more than its length of {r / u.m:.3g} m; give a smaller tension_N')
        return (Cable if self.slack else Spring)(k, L0)

    def known(self, r: float) -> float | None:
        """The tension in N of a member of length `r` in mm; None if the tension follows from the balance with the others."""
        if self.tension_N is not None:
            return self.tension_N * u.N
        return None if self.rest_length_m is None else float(self.law_at(r, 0.0).dphi(r))


def joined(atoms: Atoms, members: tuple[Members, ...], **sites: Any) -> Atoms:
    """The net of these members between the nodes `atoms`, with its PairCalculator.

    Raises
    ------
    ValueError
        If a member joins a node that does not exist; if no tensions of the other members balance the given ones, or several do;
        if a cable would have to push.
    """
    ends, groups = zip(*((pair, group) for group in members for pair in group.between), strict=True)
    bare = net(atoms, [(*pair, Spring(1.0, 0.0)) for pair in ends], **sites)
    lengths = repulsion_of(bare).bonds.lengths
    tensions = np.array([group.known(r) for group, r in zip(groups, lengths, strict=True)], float)  # NaN where not known
    if np.isnan(tensions).any():
        tensions = _balanced(bare, np.nan_to_num(tensions), ~np.isnan(tensions))
    for (i, j, _), group, t in zip(ends, groups, tensions, strict=True):
        if group.slack and t < -UNBALANCED * abs(tensions).max():
            raise ValueError(f'members: the cable from {i} to {j} would push with {-t:.3g} N, but cables go slack; remove its '
                             f'slack = true, or give other tensions')
    laws = [group.law_at(r, t) for group, r, t in zip(groups, lengths, tensions, strict=True)]
    return net(atoms, [(*pair, law) for pair, law in zip(ends, laws, strict=True)], **sites)


def _balanced(bare, tensions, known):
    """The tensions in N of all members, of which some are known."""
    states = self_stress(bare)
    share, *_ = np.linalg.lstsq(states[:, known].T, tensions[known], rcond=None)
    left = abs(share @ states[:, known] - tensions[known]).max(initial=0.0)
    if left > UNBALANCED * abs(tensions).max(initial=0.0):
        raise ValueError('members: the other members cannot balance the given tensions: the nearest balanced tensions differ by '
                         f'{left:.3g} N ({len(states)} states of self-stress); change them')
    undecided = len(states) - (np.linalg.matrix_rank(states[:, known]) if known.any() else 0)
    if undecided:
        raise ValueError(f'members: the nodes have {len(states)} states of self-stress; give tension_N or rest_length_m of '
                         f'{undecided} more independent members')
    return share @ states
