"""Three tensegrities whose frequencies are saved in the repository of TsgFEM, written anew from nodes, members and forces.

TsgFEM spreads the mass of a member along it, which couples its two nodes: the stiffness here is that of the package, the mass
matrix is built beside it. Its axial law is linear, t = E A (l - l0)/l0.
"""

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from scipy.linalg import eigh

from magphonon.interactions import Spring
from magphonon.stiffness import net

STEEL, STRING = 206.04395604395602e9, 75.998509224175415e9  # Pa, of bars and of strings
TURN = 2 * np.pi / 3 * np.arange(3)


@dataclass(frozen=True)
class Tensegrity:
    """A structure in SI.

    Attributes
    ----------
    nodes : ndarray, shape (nodes, 3)
    members : tuple
        Groups of equal members: the pairs of nodes, E, A, the force (tension is positive) and the mass of each.
    pinned : tuple of int
        Components (3 node + axis) that are held.
    saved : tuple of float
        The frequencies of TsgFEM in Hz, without those of free motions.
    """

    nodes: np.ndarray
    members: tuple
    pinned: tuple
    saved: tuple

    def frequencies(self, model):
        """Frequencies in Hz, ascending, without those of free motions."""
        n, each = len(self.nodes), [(*pair, *group[1:]) for group in self.members for pair in group[0]]
        joined, M = [], np.zeros((n, n))
        for i, j, E, A, force, mass in each:
            l0 = np.linalg.norm(self.nodes[j] - self.nodes[i]) / (1 + force / (E * A))
            joined.append((i, j, Spring(E * A / l0, l0)))
            M[[i, j], [i, j]] += mass / 3
            M[[i, j], [j, i]] += mass / 6
        K = net(Atoms(f'H{n}', self.nodes, masses=np.ones(n)), joined, dim=3).calc.rest_hessian(model).toarray()
        free = np.setdiff1d(np.arange(3 * n), self.pinned)
        squares = eigh(K[np.ix_(free, free)], np.kron(M, np.eye(3))[np.ix_(free, free)], eigvals_only=True)
        return np.sqrt(abs(squares[-len(self.saved):])) / (2 * np.pi)


def _ring(radius, turned, z):
    return np.stack([radius * np.cos(TURN + turned), radius * np.sin(TURN + turned), np.full(3, z)], axis=1)


TOWER = Tensegrity(
    np.vstack([_ring(10.0, np.pi / 6 * k, 30.0 * k) for k in range(3)]),
    ((((0, 4), (1, 5), (2, 3), (4, 8), (5, 6), (3, 7)), STEEL, 0.0887001391119068, -1e5, 1.2454336495399107e6),
     (((3, 4), (4, 5), (5, 3)), STRING, 4.581174561288e-4, 56050.67075735606, 62.346717284978954),
     (((6, 7), (7, 8), (8, 6)), STRING, 2.290587280644e-4, 28025.33537867803, 31.173358642489447),
     (((0, 3), (1, 4), (2, 5), (3, 6), (4, 7), (5, 8)), STRING, 6.973305097281e-4, 85318.38786523355, 166.80405839915707)),
    tuple(range(9)),
    (0.0108886697236709, 0.0195394549537759, 0.033964542324659, 0.0339645423246657, 0.1955933101601846, 0.1955933101601994,
     0.2752722622063401, 0.2752722622063637, 0.2934010791770417, 0.348456972038769, 0.3484569720387873, 0.4125136341117243,
     3.9142912332076105, 3.914291233207611, 3.9258744719270924, 8.610031002648665, 8.610031002648668, 8.620964452912498))
T_BAR = Tensegrity(
    np.array([[-1.0, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]]),
    ((((0, 2), (1, 3)), 8.1e9, 0.0035461536035683, -2000.0, 19.150562885446647),
     (((0, 1), (2, 3)), 2e6, 0.0014142135623731, 3232.488142567087, 2.2666666666666666),  # shortened to 0.7: it is not at rest
     (((1, 2), (3, 0)), 2e6, 0.0014142135623731, 1414.2135623730949, 2.2666666666666666)),
    (),
    (2.631486133912873, 3.721566671641001, 4.0140453324262557, 5.0911889678127418, 5.0911889678132836, 5.3356587882017115,
     393.34132131113296, 393.36870692293138))
D_BAR = Tensegrity(
    np.vstack([[0, 0, 0], [6, 0, 0], [[3, 1.091910702798607 * np.cos(t), 1.091910702798607 * np.sin(t)]
                                      for t in np.pi / 2 + 2 * np.pi / 3 * np.arange(3)]]),
    ((((0, 2), (0, 4), (0, 3), (1, 2), (1, 4), (1, 3)), STEEL, 1.4947102824499087e-3, -3547.2592415863733, 1877.7691482941086),
     (((2, 3), (3, 4), (4, 2)), STRING, 1.1450119206135572e-5, 1400.9220848706873, 0.17015075568268806),
     (((0, 1),), STRING, 8.1732733959950945e-5, 1e4, 3.8532164044992805)),
    (0, 1, 2, 4, 5),
    (2.617631528982151, 2.6176315289824448, 4.535527173900035, 21.533521044740127, 21.533521044740127, 33.831266434434767,
     58.711266748107747, 58.711266748107747, 95.804860876207357))
STRUCTURES = {'tower of two floors': TOWER, 'T-bar': T_BAR, 'D-bar in space': D_BAR}
