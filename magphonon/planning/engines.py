"""Time and memory that each engine needs for the time steps of a patch."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Engine:
    """Time and memory of an engine on one core.

    Attributes
    ----------
    seconds : float
        Time for one particle and one time step in s, as `python benchmarks/engines.py` measures it for patches of 1e4 to 1e6
        magnets in a plane.
    bytes : float
        Memory for one particle.
    overhead : float
        Time in s that one step takes in Python besides the particles, measured with patches of 61 to 5000 magnets; negligible
        in larger ones.
    """

    seconds: float
    bytes: float
    overhead: float = 0.0

    def run(self, particles: float, steps: float) -> float:
        """Time in s of a run in time steps."""
        return steps * (self.overhead + particles * self.seconds)


COMPILED = Engine(6e-9, 1100.0, 9e-6)
NUMPY = Engine(32e-9, 1100.0, 1.1e-4)
LAMMPS = Engine(60e-9, 1000.0)


def engine_costs(particles: int, steps: int) -> str:
    """Time and memory of a run in time steps by each engine, as a sentence.

    Compiled steps are the fastest on one machine at every size.  LAMMPS spreads a patch over several machines, where one is
    too small for it.

    Parameters
    ----------
    particles, steps : int

    Examples
    --------
    >>> from magphonon.planning.engines import engine_costs
    >>> engine_costs(10**6, 10**4).partition(', ')[0]
    '1000000 particles in 10000 steps take about 1 min and 1 GiB by compiled steps (numba)'
    """
    compiled, numpy, lammps = (_duration(engine.run(particles, steps)) for engine in (COMPILED, NUMPY, LAMMPS))
    return (f'{particles} particles in {steps} steps take about {compiled} and {particles * COMPILED.bytes / 2**30:.2g} GiB by '
            f'compiled steps (numba), {numpy} without them, {lammps} by LAMMPS on one rank; '
            '"magphonon burst --engine lammps --ranks N" divides the last by about N')


def _duration(seconds):
    for unit, name in ((3600, 'h'), (60, 'min')):
        if seconds >= unit:
            return f'{seconds / unit:.2g} {name}'
    return f'{max(seconds, 0.01):.2g} s'
