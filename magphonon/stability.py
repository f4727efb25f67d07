"""Which foundation a lattice needs: the static forces of repelling particles push every bond to turn aside."""

import numpy as np

from .bands import repulsion_of
from .errors import whole
from .stiffness import bloch_matrix, model_stiffness

ROUND_OFF = 1e-12
"""Of the largest eigenvalue: what remains of a zero one."""


def foundation_needed(atoms, model='complete', steps=48):
    """Smallest foundation stiffness that holds a lattice in its plane.

    A lattice on springs k is stable if every eigenvalue of its Bloch matrix D(q) + k is positive; masses do not
    matter.  The lowest one is searched on a mesh over the zone.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion, whose own foundation does not enter.
    model : {'complete', 'conventional'}
        The conventional model needs none for any lattice: it hides what this function is for.
    steps : int
        Wavevectors along each reciprocal vector; a multiple of 6 meets M and K of the hexagonal lattices.

    Returns
    -------
    k : float
        In N/mm; zero if the lattice holds itself.
    q : ndarray, shape (3,)
        Wavevector of the softest mode in fractions of the reciprocal vectors.

    Raises
    ------
    ValueError
        For an unknown model, `steps` that is no whole number, or atoms without MagneticRepulsion.
    """
    calc = repulsion_of(atoms)
    axis = np.arange(whole('steps', steps)) / steps
    q = np.stack(np.meshgrid(*(axis if periodic else [0.0] for periodic in atoms.pbc)), axis=-1).reshape(-1, 3)
    K = model_stiffness(calc.bonds.vectors[:, : calc.dim], calc.potential, model)
    stiffness = np.linalg.eigvalsh(bloch_matrix(calc.bonds, K, q))
    lowest = stiffness[:, 0].min()
    softest = q[stiffness[:, 0].argmin()]
    return (float(-lowest) if -lowest > ROUND_OFF * stiffness.max() else 0.0), softest
