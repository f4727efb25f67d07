"""Benches of strangers, drawn: magnets in a lattice, the table of their forces as some instrument exports it, and their scene.

Nothing here is computed by the package: forces follow from charged faces of discs or from a power law, frequencies from sums over
all neighbours within five spacings.
"""

import re
from dataclasses import dataclass

import numpy as np

BASES = {  # lattice vectors and basis in spacings
    'chain': ([[1, 0]], [[0, 0]]),
    'square': ([[1, 0], [0, 1]], [[0, 0]]),
    'triangular': ([[1, 0], [0.5, 0.75**0.5]], [[0, 0]]),
    'honeycomb': ([[3**0.5, 0], [0.75**0.5, 1.5]], [[0, 0], [0.75**0.5, 0.5]]),
    'kagome': ([[2, 0], [1, 3**0.5]], [[0, 0], [1, 0], [0.5, 0.75**0.5]]),
}
REACH = 5.0  # spacings, within which neighbours are summed
HEADERS = ('r_mm,f_N', 'Abstand [mm];Kraft [N]', 'Distance (cm)\tForce (mN)', 'r [mm],F [gf]', 'Abstand / cm;Kraft / mN',
           'd [cm],Mean [N],Standard deviation [N]', 'Kraft [N];Abstand [mm]', '# Prüfstand Süd\nZeit [s];Abstand [mm];Kraft [N]',
           'dist_cm,force_gf', 'Time,Force,Distance\nsec,N,mm')
UNITS = {'mm': 1e-3, 'cm': 1e-2, 'N': 1.0, 'mN': 1e-3, 'gf': 9.80665e-3, 's': 1.0, 'sec': 1.0}  # in SI
STEADY = 1.3  # least ratio of the stiffness of a foundation to what holds the lattice of the draw, save for the frail ones


def neighbours(kind):
    """Vectors in spacings from one particle of the cell to another, shape (bonds, 2), and the numbers i, j of the two."""
    vectors, basis = (np.array(x, float) for x in BASES[kind])
    counts = np.arange(-12, 13)
    cells = np.stack(np.meshgrid(*[counts] * len(vectors)), -1).reshape(-1, len(vectors)) @ vectors
    d = cells[:, None, None] + basis[None, None] - basis[None, :, None]
    _, i, j = keep = np.nonzero((np.hypot(*np.moveaxis(d, -1, 0)) < REACH) & (np.hypot(*np.moveaxis(d, -1, 0)) > 0.1))
    return d[keep], i, j


def shells(kind):
    """Distances of the shells in spacings."""
    return np.unique(np.hypot(*neighbours(kind)[0].T).round(6))


def squares(kind, spacing, mass, k, force):
    """Squares of angular frequencies in SI on a grid of wavevectors, with all neighbours within the reach."""
    d, i, j = neighbours(kind)
    r, many = np.hypot(*d.T) * spacing, len(BASES[kind][1])
    f, slope = force(r), (force(1.001 * r) - force(0.999 * r)) / (0.002 * r)
    n = d / np.hypot(*d.T)[:, None]
    K = -(slope + f / r)[:, None, None] * n[:, :, None] * n[:, None] - (f / r)[:, None, None] * -np.eye(2) * -1
    own = np.zeros((many, 2, 2))
    np.add.at(own, i, K)
    found = []
    for q in 2 * np.pi * np.random.default_rng(0).uniform(-0.5, 0.5, (200, 2)):
        D = np.zeros((many, 2, many, 2), complex)
        np.add.at(D.transpose(0, 2, 1, 3), (i, j), -K * np.exp(1j * d @ q)[:, None, None])
        for one in range(many):
            D[one, :, one] += own[one] + k * np.eye(2)
        found.append(np.linalg.eigvalsh(D.reshape(2 * many, -1)) / mass)
    return np.array(found)


def disc_force(radius, height, remanence):
    """The force in N between two upright discs side by side, by the charges of their faces."""
    x, w = np.polynomial.legendre.leggauss(8)
    r, angle = radius * (x + 1) / 2, (np.arange(16) + 0.5) * np.pi / 8
    place = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], -1).reshape(-1, 2)
    charge = np.repeat(w * radius / 2 * r, 16) * np.pi / 8 * remanence / (4e-7 * np.pi)

    def force(distance):
        D = place[:, None] - place + np.array([1.0, 0]) * np.reshape(distance, (-1, 1, 1, 1))
        near = (D**2).sum(-1)
        field = D[..., 0] * (near**-1.5 - (near + height**2) ** -1.5)
        return 2e-7 * np.pi * np.einsum('i,j,rij->r', charge, charge, field) / np.pi

    table = np.geomspace(2.05 * radius, 250 * radius, 200)  # of which the logarithm is smooth
    known = np.log(force(table))
    return lambda distance: np.exp(np.interp(np.log(distance), np.log(table), known))


@dataclass
class Bench:
    """One bench in SI: its lattice, what it is made of, and its table as bytes."""

    kind: str
    spacing: float
    mass: float
    stiffness: float
    needed: float  # of the foundation
    force: float  # between nearest neighbours
    hertz: tuple  # lowest and highest frequency
    table: bytes
    hole: bool
    tolerance: bool
    ready: str  # the scene to start from

    def scene(self, text):
        """The scene with the numbers of this bench, edited line by line as a user does."""
        L, sides = self.spacing, {'honeycomb': (17, 20), 'kagome': (18, 22)}.get(self.kind, (12, 14))
        patch = '\n[patch]\nkind = "rectangle"\nwidth_m = {:.6g}\nheight_m = {:.6g}\n'.format(*np.array(sides) * L)
        place = ((0.2 * L, 6.1 * L), (0.3 * L, 3.1 * L))[self.ready == 'prototype']
        for key, value in {'kind = "(triangular|square)"': f'kind = "{self.kind}"', 'spacing_m': L, 'mass_kg': self.mass,
                           'cycles': None, 'duration_s': None,
                           'carriers_Hz': f'[{(self.hertz[0] + 2 * self.hertz[1]) / 3:.4g}]\ncycles = 2\nduration_s = '
                                          f'{10 / self.hertz[1]:.4g}', 'force_N': 1e-4 * self.needed * L,
                           'path': None, 'directions_deg': None}.items():
            line = f'{key} = {value}' if '=' not in key else value
            text = re.sub(rf'(?m)^{key}( .*)?$', '' if value is None else line, text)
        text = re.sub(r'(?s)\[foundation.*?(?=\n\[)', self.support(), text)
        text = re.sub(r'(?s)\n\[patch.*?(?=\n\[)', '' if self.kind == 'chain' else patch, text)
        if self.kind == 'chain':
            text = re.sub(r'(?s)\n\[burst.*?(?=\n\[|$)', '', text)
        return text + (f'\n[defects]\nvacancies_m = [[{place[0]:.6g}, {place[1]:.6g}]]\n' if self.hole else '')

    def support(self):
        """The table of the foundation: pillars of aluminium, or springs."""
        height = (3 * 71e9 * np.pi / 4 * (0.08 * self.spacing) ** 4 / self.stiffness) ** (1 / 3)
        if self.tolerance:
            return f'[foundation]\nstiffness_N_per_m = {self.stiffness:.6g}\n'
        return f'[foundation.pillar]\nyoungs_modulus_Pa = 71e9\nradius_m = {0.08 * self.spacing:.6g}\nheight_m = {height:.6g}\n'


def drawn(seed):
    """The bench number `seed`."""
    rng = np.random.default_rng([47, seed])
    kind, spacing = str(rng.choice([*BASES])), float(np.round(rng.uniform(5e-3, 40e-3), 4))
    first, last = rng.uniform(0.75, 0.97), np.exp(rng.uniform(np.log(1.1), np.log(4.0)))
    if rng.random() < 0.6:  # the table ends at a shell, or just before or behind it
        known = shells(kind)
        last = rng.choice(known[(known > 1.1) & (known < 4)]) * rng.uniform(0.98, 1.02)
    if rng.random() < 0.5:
        radius = rng.uniform(0.2, 0.47 * first) * spacing
        height, remanence = radius * rng.uniform(0.3, 2.0), rng.uniform(1.0, 1.4)
        force, mass = disc_force(radius, height, remanence), 7500 * np.pi * radius**2 * height
    else:
        a, strength = rng.uniform(3, 5.5), np.exp(rng.uniform(np.log(0.03), np.log(1.0)))
        force, mass = (lambda r: strength * (spacing / r) ** a), rng.uniform(0.3e-3, 5e-3)
    k = -squares(kind, spacing, 1.0, 0.0, force).min()
    needed = max(k, 4 * force(np.array([spacing]))[0] / spacing)
    stiffness = needed * rng.uniform(*(0.5, 0.95) if rng.random() < 0.15 else (STEADY, 4))
    omega2 = squares(kind, spacing, mass, max(stiffness, 1.05 * needed), force)
    hertz = tuple(float(np.sqrt(x) / (2 * np.pi)) for x in (omega2.min(), omega2.max()))
    r = np.linspace(first, last, int(rng.integers(10, 40))) * spacing
    f = force(r) * (1 + rng.normal(0, 0.01, len(r))) + force(r).max() * (2e-4 + rng.normal(0, 2e-4, len(r)))
    hole = kind != 'chain' and rng.random() < 0.3
    ready = 'square' if kind == 'square' and rng.random() < 0.7 else 'prototype'
    return Bench(kind, spacing, float(np.round(mass, 7)), float(stiffness), float(needed),
                 float(force(np.array([spacing]))[0]), hertz, written(rng, r, f), bool(hole),
                 bool(rng.random() < 0.5), ready)


def written(rng, r, f):
    """The table in bytes, as an instrument writes it."""
    header = str(rng.choice(HEADERS))
    names = re.split('[,;\t]', header.split('\n')[0 if header[0] != '#' else 1])
    words = [*map(str, names)] if 'sec' not in header else ['Time [s]', 'Force [N]', 'Distance [mm]']
    sign = next(sign for sign in '\t;,' if sign in header)
    columns = []
    for word in words:
        unit = UNITS[re.search(r'(mm|cm|mN|gf|N|s)\W*$', word)[1]]
        what = word.lower()
        values = (r if re.match('r|abst|dist|d ', what) else 0.01 * f.max() + 0 * f if what.startswith('standard') else
                  np.arange(len(r)) if re.match('time|zeit', what) else f)
        columns.append(values / unit)
    comma = sign != ',' and rng.random() < 0.6
    rows = [sign.join(f'{x:.6g}' for x in row) for row in zip(*columns, strict=True)]
    text = '\n'.join([header, *(row.replace('.', ',') if comma else row for row in rows)]) + '\n'
    return text.encode(str(rng.choice(['utf-8', 'cp1252', 'utf-16', 'utf-8-sig'])))
