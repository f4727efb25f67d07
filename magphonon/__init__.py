"""Static forces in repulsive lattices: stiffness D0 + D*, bands, waves; on ASE and phonopy (arXiv:1911.10410).

A lattice is an `ase.Atoms` with the calculator `MagneticRepulsion`; lengths are in mm, masses in g, times in ms,
so forces are in N, and frequencies are printed in Hz:

>>> from magphonon import MagneticRepulsion, InversePower, analytic_bands, lattices, units as u
>>> cell = lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g)
>>> law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
>>> cell.calc = MagneticRepulsion(cell, law, foundation=19.6757 * u.N / u.m)
>>> bands = analytic_bands(cell, 'GMKG')
>>> print(f'{bands.frequencies_Hz.max():.1f} Hz')
149.5 Hz

`dir(magphonon)` lists the most used names. The subpackages hold the others: `lattices` (cells, patches, bonds), `interactions`
(laws, magnets, fits of forces), `stiffness` (the calculator, D0 + D*), `bands`, `dynamics` (time steps), `response` (modes,
transfer functions, densities), `waves` (bursts, scans), `stability`, `design`, `scenes`, `plotting`, `units`.
"""

from pathlib import Path

import lazy_loader

__version__ = '0.4.0'

if not (Path(__file__).parent / 'data').is_dir():  # a checkout: data and workflows stand beside the package
    __path__.append(str(Path(__file__).parents[1]))

# The names repeat those of the stub file __init__.pyi, which type checkers read: reading it here would add a third to the import
# time.
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, [
    'bands', 'design', 'dynamics', 'interactions', 'lattices', 'plotting', 'response', 'scenes', 'stability', 'stiffness',
    'units', 'waves',
], {
    'bands': ['analytic_bands', 'finite_displacements', 'phonopy_bands'],
    'dynamics': ['DrivenVerlet', 'ToneBurst'],
    'interactions': ['InversePower', 'magnet_law'],
    'plotting': ['plot_bands'],
    'response': ['frequency_response', 'modes', 'propagate'],
    'scenes': ['read_scene'],
    'stability': ['critical_foundation', 'verdict'],
    'stiffness': ['MagneticRepulsion', 'relaxed'],
    'sweeps': ['sweep'],
})
