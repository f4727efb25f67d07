"""Runs in LAMMPS, an independent code: input files, and runs by the program `lmp` on several MPI ranks.

LAMMPS gets the same list of bonds as the other engines. Each bond has its strength and its pair law, as a table whose
interpolation is exact to round-off.  The input also has the springs, masses and constant forces of each site, tone bursts and
damping.  LAMMPS computes forces from absolute positions, not from displacements.

All files of a run are in one folder, which can be copied to a cluster: `submit.sh` runs it there, and continues from the newest
restart file if it is submitted again.  `run_lammps` with the same arguments then reads the records.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from collections.abc import Sequence
from importlib import metadata
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms
from numpy.typing import NDArray

from ..errors import indices, not_negative, one_of, positive, whole
from ..files import whole_file
from ..interactions.bond_laws import groups
from ..stiffness.calculator import PairCalculator
from ..traits import takes
from .drives import Drives, ToneBurst
from .motion import Motion

GROUPS = 32  # largest number of groups of particles that LAMMPS has, three of which are all, free and fixed
INTERPOLATIONS = ('spline', 'linear')
CLOSEST, FARTHEST = 0.5, 2.0
"""First and last distance of the force tables as fractions of the shortest and the longest bond; LAMMPS stops beyond."""
INPUT = """\
# {particles} particles written by magphonon: mm, g, ms, hence N and mJ; to LAMMPS any consistent units are "lj"
units lj
dimension {dim}
boundary f f {across}
atom_style bond
atom_modify map array
# a bond is a pair of the pair style below, times its factor; the list of pairs itself is empty
special_bonds lj/coul 0 1 1
bond_style special
{sites}
read_data particles.data fix sites NULL Sites
group free type 1:{free_types}
group fixed subtract all free
{motion}"""
MOTION = """\

pair_style table {interpolation} {points}
{pairs}
neighbor 0 bin
neigh_modify once yes exclude group all all

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
{sites}
{motion}"""
CAUGHT_UP = """\
# damping acts on the velocity of the previous half step, which a restart file does not contain: correct the velocities for it
run 0 post no
variable vx atom "(vx-{h:.17g}*(vx-{k:.17g}*fx/mass)/{rest:.17g})/{rest:.17g}"
variable vy atom "(vy-{h:.17g}*(vy-{k:.17g}*fy/mass)/{rest:.17g})/{rest:.17g}"
velocity free set v_vx v_vy NULL
"""
AT_END = 'print "complete" file complete\n'
RESTARTS = 'restart.a', 'restart.b'  # restart files, written alternately, so that one is complete whenever LAMMPS is killed
RESTARTS_OF_A_RUN = 20  # number of restart files that a run writes; a killed run loses at most this fraction of its steps
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
FRAME = 'ITEM: TIMESTEP\n'
HEADER = 8  # number of header lines between FRAME and the particles of a frame


@takes('constraints')
def write_lammps_input(directory: str | PathLike[str], atoms: Atoms, timestep: float, steps: int, *,
                       drives: Sequence[ToneBurst] = (), damping: float = 0.0, interval: int | None = None,
                       interpolation: str = 'spline', points: int = 20_000,
                       records: Sequence[tuple[Any, int]] = (), restart: int | None = None) -> None:
    """Write in.lammps, particles.data and law.table, with which LAMMPS computes the same motion from rest as `DrivenVerlet`.

    LAMMPS damps by `-c v` with the velocity of the previous half step.  With `c = (1 - e^(-gamma dt)) m'/dt` and the mass
    `m' = 2 m/(1 + e^(-gamma dt))` the positions are those of the exact decay by e^(-gamma dt) in each step.

    Parameters
    ----------
    directory : path-like
        Where to write; it must exist.
    atoms : ase.Atoms
        A patch at rest with its PairCalculator; FixAtoms is the only constraint allowed.
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
        Interpolation between the points of the table, which are equidistant in r^2.  A spline of 20 000 points is exact to
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
        If LAMMPS cannot run this scene: periodic, moving or displaced particles, another model or constraint, drives other than
        tone bursts, magnets that leave the plane by their own law, or more drives and records than LAMMPS has groups for.

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
    calc, law, fixed = _scene(atoms)
    timestep, damping = positive('timestep', timestep, 'ms'), not_negative('damping', damping, '1/ms')
    steps, points = whole('steps', steps, least=0), whole('points', points, least=2)
    one_of('interpolation', interpolation, INTERPOLATIONS)
    Drives(drives, len(atoms))  # refuses indices of no particle, which LAMMPS would ignore
    if calc.dim == 3 and (records or restart is not None):
        raise ValueError('records and restarts with LAMMPS are possible only for motion in the plane; use interval= to write '
                         'all particles, or atoms.calc = atoms.calc.in_plane()')
    if (named := len(drives) + sum(particles is not None for particles, _ in records)) > GROUPS - 3:
        raise ValueError(f'LAMMPS has groups for at most {GROUPS - 3} drives and records of some particles, not for {named}')
    axes = 'xyz'[: calc.dim]
    decay = np.exp(-damping * timestep)
    sites = {'rmass': atoms.get_masses() * 2 / (1 + decay)}
    fixes = [*_springs(calc, sites, axes), *_offset(calc, sites, axes)]
    for n, drive in enumerate(drives):
        fixes += _burst(n, drive, sites, len(atoms))
    slowed, caught_up = _damping(decay, timestep, sites['rmass'], axes)
    laws = groups(law, len(calc.bonds))
    tags = calc.reference.get_tags() * (len(laws) > 1)
    kinds, types = np.unique(np.column_stack([fixed, tags]), axis=0, return_inverse=True)  # free ones first
    types = types.ravel()

    output = _output(len(atoms), interval, records, ' '.join(axes))
    if restart is not None:
        output += f'restart {whole("restart", restart)} {" ".join(RESTARTS)}\n'
    motion = MOTION.format(interpolation=interpolation, points=points, pairs='\n'.join(_pairs(calc.bonds, laws, types)),
                           fixes='\n'.join(fixes), timestep=timestep)
    columns = f'fix sites all property/atom {" ".join(sites)}'
    run = f'run {steps} upto\n' + (AT_END if records else '')
    directory = Path(directory)
    with whole_file(directory / 'law.table') as file:
        for n, (law, _) in enumerate(laws):
            _write_table(file, f'LAW{n}', law, CLOSEST * calc.bonds.lengths.min(), FARTHEST * calc.bonds.lengths.max(), points)
    with whole_file(directory / 'particles.data') as file:
        _write_particles(file, calc, types, sites)
    with whole_file(directory / 'in.lammps') as file:
        file.write(INPUT.format(particles=len(atoms), dim=calc.dim, across='f' if calc.dim == 3 else 'p', sites=columns,
                                free_types=(kinds[:, 0] == 0).sum(), motion=motion + slowed + output + run))
    if restart is not None:
        with whole_file(directory / 'in.restart') as file:
            continued = output.replace('sort id', 'append yes sort id')
            file.write(CONTINUED.format(sites=columns, motion=motion + caught_up + slowed + continued + run))


def _scene(atoms):
    """Calculator and law of the patch, and which particles are fixed; refuses a scene that LAMMPS cannot run."""
    calc = atoms.calc
    if not isinstance(calc, PairCalculator):
        raise ValueError(f'atoms.calc must be a PairCalculator, not {calc!r}')
    if atoms.pbc.any():
        raise ValueError(f'LAMMPS can run finite patches only, not a structure with pbc {tuple(map(int, atoms.pbc))}; cut a '
                         'patch, for instance with lattices.parallelogram')
    law = calc.law
    if not len(calc.bonds):
        raise ValueError('no two particles are bonded, so there is nothing for LAMMPS to compute')
    if calc.displacements(atoms).any() or atoms.get_momenta().any():
        raise ValueError('the particles must start at rest in their reference positions; set atoms.positions and momenta back')
    fixed = np.zeros(len(atoms), dtype=bool)
    for constraint in atoms.constraints:
        if not isinstance(constraint, FixAtoms):
            raise ValueError(f'LAMMPS can hold particles by FixAtoms only, not {constraint!r}')
        fixed[constraint.index] = True
    return calc, law, fixed


def _springs(calc, sites, axes):
    """Fixes for the foundation: LAMMPS takes its springs as slack at rest, and `_offset` adds the force with which they pull."""
    if not isinstance(calc.foundation, np.ndarray):
        return [f'fix foundation free spring/self {calc.foundation:.17g}'] if calc.foundation else []
    lines = []
    for x, k in zip(axes, np.broadcast_to(calc.foundation, (len(calc.reference), len(axes))).T, strict=True):
        sites[f'd_k{x}'] = k
        lines += [f'variable k{x} atom d_k{x}', f'fix foundation{x} free spring/self v_k{x} {x}']
    return lines


def _offset(calc, sites, axes):
    """The fix for constant forces: dead loads, and springs of the foundation that are not slack at rest."""
    if not calc.offset.any():
        return []
    for x, h in zip(axes, calc.offset.T, strict=True):
        sites[f'd_h{x}'] = h
    return [*(f'variable h{x} atom d_h{x}' for x in axes),
            f'fix offset free addforce {" ".join(f"v_h{x}" if x in axes else "0" for x in "xyz")}']


def _burst(n, drive, sites, count):
    """Commands for a tone burst: LAMMPS evaluates the force at the end of each step, where Verlet needs it."""
    if not isinstance(drive, ToneBurst) or drive.start < 0:
        raise ValueError(f'LAMMPS can be given only tone bursts that start at t >= 0, not {drive!r}')
    sites[f'd_drive{n}'] = np.zeros(count)
    sites[f'd_drive{n}'][drive.particles] = drive.amplitude
    ids = ' '.join(str(i + 1) for i in drive.particles)
    s, w = f'(time-{drive.start:.17g})', drive.omega
    window = f'(time>={drive.start:.17g})*(time<={drive.end:.17g})*0.5*(1-cos({w / drive.cycles:.17g}*{s}))'
    return [f'group driven{n} id {ids}',
            f'variable burst{n} equal "{window}*sin({w:.17g}*{s})"',
            *(f'variable f{x}{n} atom "{share:.17g}*v_burst{n}*d_drive{n}"'
              for x, share in zip('xyz', drive.direction, strict=True)),
            f'fix drive{n} driven{n} addforce v_fx{n} v_fy{n} v_fz{n}']


def _damping(decay, timestep, masses, axes):
    """Commands that damp velocities by the factor `decay` in each step, and those that correct for it after a restart."""
    if decay == 1:
        return '', ''
    rate, half = (1 - decay) / timestep, (1 - decay) / 2
    if np.ptp(masses) == 0:
        damping = f'fix damping free viscous {rate * masses[0]:.17g}\n'
    else:
        damping = ''.join(f'variable d{x} atom "-{rate:.17g}*mass*v{x}"\n' for x in axes)
        damping += f'fix damping free addforce {" ".join(f"v_d{x}" if x in axes else "0" for x in "xyz")}\n'
    return damping, CAUGHT_UP.format(h=half, k=timestep / 2, rest=1 - half)


def _output(count, interval, records, axes):
    lines = [] if interval is None else [OUTPUT.format(name='trajectory', group='all', axes=axes,
                                                       interval=whole('interval', interval))]
    for n, (particles, every) in enumerate(records):
        group = 'all' if particles is None else f'recorded{n}'
        if particles is not None:
            particles = indices('particles to record', particles, count)
            lines.append(f'group {group} id {" ".join(map(str, particles + 1))}\n')
        lines.append(OUTPUT.format(name=f'record{n}', group=group, axes=axes, interval=whole('interval', every)))
    return ''.join(lines)


def _pairs(bonds, laws, types):
    """Lines that assign a table to each pair of types; pairs that no bond joins get that of the first law, which is not used."""
    lines = ['pair_coeff * * law.table LAW0']
    for n, (_, own) in enumerate(laws[1:], 1):
        joined = np.unique(np.sort(np.column_stack([types[bonds.i[own]], types[bonds.j[own]]]), axis=1), axis=0)
        lines += [f'pair_coeff {a + 1} {b + 1} law.table LAW{n}' for a, b in joined]
    return lines


def _write_table(file, name, law, shortest, longest, points):
    r = np.sqrt(np.linspace(shortest**2, longest**2, points))
    file.write(f'# pair law by magphonon: number, r in mm, energy in mJ, force in N\n{name}\n'
               f'N {points} RSQ {shortest:.17g} {longest:.17g} FPRIME {-law.d2phi(r[0]):.17g} {-law.d2phi(r[-1]):.17g}\n\n')
    np.savetxt(file, np.column_stack([np.arange(1, points + 1), r, law.phi(r), -law.dphi(r)]), fmt='%d %.17g %.17g %.17g')
    file.write('\n')


def _write_particles(file, calc, types, sites):
    positions, bonds, margin = calc.reference.positions, calc.bonds, calc.bonds.lengths.max()
    low, high = positions.min(axis=0) - margin, positions.max(axis=0) + margin
    factors, factor = np.unique(calc.strengths[bonds.i] * calc.strengths[bonds.j], return_inverse=True)
    number = np.arange(1, len(types) + 1)
    file.write(f'# patch by magphonon: mm, g\n{len(positions)} atoms\n{types.max() + 1} atom types\n'
               f'{len(bonds)} bonds\n{len(factors)} bond types\n'
               + ''.join(f'{a:.17g} {b:.17g} {axis}lo {axis}hi\n' for a, b, axis in zip(low, high, 'xyz', strict=True))
               + '\nBond Coeffs # special\n\n' + ''.join(f'{n} {s:.17g} {s:.17g}\n' for n, s in enumerate(factors, 1))
               + '\nAtoms # bond\n\n')
    np.savetxt(file, np.column_stack([number, 0 * number, types + 1, positions]), fmt='%d %d %d %.17g %.17g %.17g')
    file.write('\nBonds\n\n')
    np.savetxt(file, np.column_stack([np.arange(1, len(bonds) + 1), factor + 1, bonds.i + 1, bonds.j + 1]), fmt='%d')
    file.write('\nSites\n\n')
    np.savetxt(file, np.column_stack([number, *sites.values()]), fmt='%d' + ' %.17g' * len(sites))


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
        Number of MPI ranks.
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
        If LAMMPS cannot run this scene, or stops; or if the folder holds files of another run, or records that lack frames.  The
        contents of a frame are not checked: a digit that was changed in a record is read as it is.
    """
    ranks = whole('ranks', ranks)
    if directory is None:
        with TemporaryDirectory() as made:
            return run_lammps(atoms, timestep, steps, records=records, drives=drives, damping=damping, ranks=ranks,
                              directory=made)
    directory = Path(directory)
    _write(directory, atoms, timestep, steps, drives, damping, records, ranks)
    if not (directory / 'complete').exists():
        _run(directory, ranks)
    return tuple(_record(directory / f'record{n}.dump', atoms, particles, timestep, range(0, steps + 1, interval))
                 for n, (particles, interval) in enumerate(records))


def _write(directory, atoms, timestep, steps, drives, damping, records, ranks):
    """Write the input files that are missing; ValueError if the folder holds another input, or other files with these names."""
    with TemporaryDirectory() as made:
        stage = Path(made)
        write_lammps_input(stage, atoms, timestep, steps, drives=drives, damping=damping, records=records,
                           restart=max(1, steps // RESTARTS_OF_A_RUN))
        outputs = [*(f'record{n}.dump' for n in range(len(records))), *RESTARTS, 'complete', 'log.lammps', 'submit.sh']
        missing = _missing(directory, stage, outputs)
        directory.mkdir(parents=True, exist_ok=True)
        for name in missing:
            shutil.copyfile(stage / name, directory / name)
    if not (directory / 'submit.sh').exists():  # which may have been fitted to a cluster
        with whole_file(directory / 'submit.sh') as file:
            file.write(BATCH.format(ranks=ranks, restarts=' '.join(RESTARTS)))


def _missing(directory, stage, outputs):
    """The names of the files of `stage` that the folder lacks; ValueError if it holds others, or outputs without an input."""
    inputs = [file.name for file in stage.iterdir()]
    there = [name for name in inputs if os.path.lexists(directory / name)]
    for file in (directory / name for name in inputs + outputs if os.path.lexists(directory / name)):
        ours = file.is_file() and not file.is_symlink() and bool(there)
        if not ours or (file.name in inputs and file.read_bytes() != (stage / file.name).read_bytes()):
            raise ValueError(f'{file} belongs to another run; name another folder, or remove this file')
    return set(inputs) - set(there)


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
        lines = (log.read_text(encoding='utf-8') if log.exists() else done.stderr + done.stdout).splitlines()
        why = next((line for line in lines if 'ERROR' in line), lines[-1] if lines else f'exit status {done.returncode}')
        raise ValueError(f'LAMMPS stopped: {why.strip()}; its files are in {directory}; lower the drives or the time step')


def _program(name, package):
    """Path of a program: in the folder of this Python's scripts, in the search path, or where a wheel installed it."""
    found = shutil.which(name, path=f'{sysconfig.get_path("scripts")}{os.pathsep}{os.environ.get("PATH", "")}')
    try:
        installed = [file.locate() for file in metadata.files(package) or () if file.name == name and file.parent.name == 'bin']
    except metadata.PackageNotFoundError:
        installed = []
    for path in (found, *installed):
        if path is not None and Path(str(path)).exists():
            return str(Path(str(path)).resolve())  # mpiexec looks for its helpers beside itself
    raise ImportError(f"the program {name} is not installed; pip install 'magphonon[peers]', or load it as the manual of your "
                      'cluster says')


def _record(file, atoms, particles, timestep, steps):
    """The record of some particles at the `steps`, a range, as a Motion; ValueError if a frame is missing."""
    particles = np.arange(len(atoms)) if particles is None else np.atleast_1d(particles)
    ordered, back = np.unique(particles, return_inverse=True)  # LAMMPS sorts by number
    try:
        frames = _frames(file, ordered)
    except (OSError, ValueError) as error:
        raise ValueError(f'{file} cannot be read ({error}); remove its folder, and LAMMPS runs again') from error
    if lacking := sorted(set(steps) - set(frames)):
        raise ValueError(f'{file} lacks {len(lacking)} of {len(steps)} frames, the first at step {lacking[0]}; remove its '
                         'folder, and LAMMPS runs again')
    places = np.array([frames[n] for n in steps])
    return Motion(timestep * np.array(steps), particles, (places - atoms.positions[ordered, :2])[:, back])


def read_lammps_displacements(directory: str | PathLike[str], atoms: Atoms) -> NDArray[np.float64]:
    """Displacements from the rest positions of `atoms`, mm, shape (frames, particles, dim), from trajectory.dump."""
    frames = _frames(Path(directory, 'trajectory.dump'), np.arange(len(atoms)))
    places = np.array([frames[n] for n in sorted(frames)])
    return places - atoms.positions[:, : places.shape[-1]]


def _frames(file, particles):
    """Positions of the particles in every complete frame of a dump, by step; a frame written twice, at a restart, counts once."""
    frames = {}
    for frame in file.read_text(encoding='utf-8').split(FRAME)[1:]:
        lines = frame.split('\n')
        if len(lines) > HEADER + len(particles):  # or cut off
            rows = np.array(' '.join(lines[HEADER:HEADER + len(particles)]).split(), dtype=float).reshape(len(particles), -1)
            if np.array_equal(rows[:, 0], particles + 1) and np.isfinite(rows).all():
                frames[int(lines[0])] = rows[:, 1:]
    return frames
