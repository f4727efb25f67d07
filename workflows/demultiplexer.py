"""The demultiplexer on the bench: who can design it, what each tolerance costs, and trim.

`python -m workflows.demultiplexer [-o DIR]` designs with four models at equal effort, builds copies of the ready scene with the
errors of a workshop, and trims those that fell below 30 dB; some minutes.  With `--device` it designs another such device,
DIR/designed.csv, in two to four minutes of one core.  An independent solver (built_device.py) judges.
"""

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from magphonon import InversePower, MagneticRepulsion, lattices, read_scene, units as u
from magphonon.design import Contrast, Errors, optimise, trim, write_build_list
from magphonon.response import Dof
from magphonon.response.transfer_functions import TransferFunction
from magphonon.scenes import ready_scene

from .built_device import DIAMETER, EXPONENT, FREQUENCIES, MAGNET, PLACES, ROD, SPRING, B, Device

GRADES, RODS = (0.87, 0.93, 1.0, 1.07, 1.15), np.array([1.33, 1.50, 1.68, 1.89]) / DIAMETER
SIZES = {'force': 2.0, 'frequency': 1.0, 'strength': 1.0, 'spring': 1.0, 'foot': 0.1}  # errors of copies, see Device.copy
WORDS = {'force': 'force of the batch', 'frequency': 'frequency of the source', 'strength': 'strength of each magnet',
         'spring': 'stiffness of each rod', 'foot': 'place of each foot'}
LARGER = {'force': 5.0, 'frequency': 2.0, 'strength': 3.0, 'spring': 4.0, 'foot': 0.3}
BESIDE = {'rim of beams 256 times as stiff as a rod': {'rim': 256.0}, 'rim 64 times as stiff': {'rim': 64.0},
          'rods as springs with 33/140 of their mass': {'waves_in_rods': False}}
ERRORS = Errors(force_percent=2, frequency_percent=1, stiffness_percent=1, each_strength_percent=1, each_stiffness_percent=1,
                each_foot_mm=0.1)
COPIES, FURTHER, SEED = 100, 1200, 1000
HZ, NOISE = np.linspace(50, 90, 21), (5e-3, 1e-3)  # at which copies are measured; noise of each response, and of the largest
TRIMMED, REFUSED = 10, 3  # copies below 30 dB that are trimmed, and with D0


def given(cutoff=45.0):
    """The lattice that is designed, of the prototype's magnets on heavy rods, with all neighbours within this many mm."""
    patch = lattices.hexagon(lattices.triangular(10 * u.mm, (MAGNET + ROD) * u.kg), 60 * u.mm)
    patch.calc = MagneticRepulsion(patch, InversePower(B * u.N * u.m**EXPONENT, EXPONENT), cutoff=cutoff * u.mm,
                                   foundation=SPRING * u.N / u.m)
    return patch


def targets(source, *ports):
    """60 Hz to the first port, 80 Hz to the second one."""
    return [Contrast(Dof(source, (1, 0, 0)), [loud], [quiet], 2 * np.pi * f * u.Hz, damping=4 / u.s)
            for f, loud, quiet in zip(FREQUENCIES, ports, ports[::-1], strict=True)]


def designed(model, cutoff, out, steps=250, draws=8, wide=1.0):
    """The device of somebody who knows this model and neighbours within `cutoff`, and takes common errors this much wider."""
    patch = given(cutoff)
    at = patch.positions[:, :2] - patch.positions[:, :2].mean(0)
    over = {'strength': (GRADES[0], GRADES[-1]), 'rod': (RODS[0], RODS[-1]), 'foot': (-1.0, 1.0)}
    ends = targets(*(int(np.hypot(*(at - np.multiply(p, u.m)).T).argmin()) for p in PLACES))
    design = optimise(patch, ends, over, parts={'strength': GRADES, 'rod': RODS}, model=model, rod_mass=ROD * u.kg, steps=steps,
                      draws=draws, errors=replace(ERRORS, force_percent=2 * wide, frequency_percent=wide, stiffness_percent=0))
    write_build_list(out / 'designed.csv', design.atoms)
    return Device.read(out / 'designed.csv')


def judged(device, count=COPIES, seed=SEED, **sizes):
    """The weaker contrasts of unseen copies; -inf for one that does not hold."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        try:
            found.append(device.copy(rng, **SIZES | sizes).decibels().min())
        except (ValueError, np.linalg.LinAlgError):
            found.append(-np.inf)
    return np.array(found)


def copies_table(device, out):
    """Rows: part of the table, what, decibels that 80 of 100 copies reach, percentages above 30 and above 20 dB."""
    cases = [('errors', 'all', device, {})]
    cases += [('alone', WORDS[name], device, dict.fromkeys(SIZES, 0.0) | {name: SIZES[name]}) for name in SIZES]
    cases += [('all but', WORDS[name], device, {name: 0.0}) for name in SIZES]
    cases += [('all, larger', f'{WORDS[name]}: {size:g} {"mm" if name == "foot" else "%"}', device, {name: size})
              for name, size in LARGER.items()]
    cases += [('all, and', words, replace(device, **changes), {}) for words, changes in BESIDE.items()]
    cases += [('designed with', f'{D}, {who}', designed(model, cutoff, out), {})
              for model, D in (('conventional', 'D0'), ('complete', 'D0 + D*'))
              for cutoff, who in ((12.0, 'nearest neighbours'), (45.0, 'all neighbours'))]
    values = [judged(one, **sizes) for *_, one, sizes in tqdm(cases, 'copies', disable=None)]
    return [(part, what, round(float(np.quantile(v, 0.2)), 1), *(round(100 * np.mean(v > level)) for level in (30, 20)))
            for (part, what, *_), v in zip(cases, values, strict=True)]


def trim_table(device):
    """Rows: copy, model of the identification, decibels as it was built and once it was trimmed, chi."""
    atoms, rng, rows = read_scene('demultiplexer').atoms(), np.random.default_rng(SEED + 1), []
    atoms.set_array('rod_masses', ROD * u.kg * np.sqrt(device.k / SPRING))
    source, *ports = device.places
    seen = [Dof(port, along) for port in ports for along in np.eye(3)[:2]]
    for copy in range(1000):
        built = device.copy(rng, **SIZES, batch=1.0, damping=0.3)
        before, h = built.decibels().min(), built.responses(HZ).reshape(len(HZ), -1).T
        noise = NOISE[0] * abs(h) + NOISE[1] * abs(h).max()
        h = h + noise * (rng.normal(size=h.shape) + 1j * rng.normal(size=h.shape))
        if before > 30:
            continue
        measured = [TransferFunction(f'port {one.particle}', 2 * np.pi * HZ * u.Hz, heard * (u.m / u.N), sigma * (u.m / u.N),
                                     drive=Dof(source, (1, 0, 0)), answer=one)
                    for one, heard, sigma in zip(seen, h, noise, strict=True)]
        for model in ('complete', 'conventional') if len(rows) < 2 * REFUSED else ('complete',):
            try:
                found = trim(atoms, targets(source, *ports), measured, parts=GRADES, errors=ERRORS, damping=4 / u.s, model=model)
            except ValueError as refused:
                rows.append((copy, model, round(before, 1), '', float(str(refused).partition('chi = ')[2].split()[0])))
                continue
            s = built.s.copy()
            s[list(found.sites)] = found.strengths * np.exp(0.01 * rng.normal(size=len(found.sites)))
            rows.append((copy, model, round(before, 1), round(replace(built, s=s).decibels().min(), 1), round(found.chi, 2)))
        if len({row[0] for row in rows}) == TRIMMED:
            return rows
    raise ValueError('too few copies fell below 30 dB')


def written(path, header, rows):
    """Print a table and write it as CSV."""
    with path.open('w', encoding='utf-8', newline='') as file:
        csv.writer(file, lineterminator='\n').writerows([header, *rows])
    print(path.read_text(encoding='utf-8'))


def main(arguments=None):
    """Design, build, trim; print the tables and write them."""
    parser = argparse.ArgumentParser(prog='python -m workflows.demultiplexer', description=__doc__.partition('\n')[0])
    parser.add_argument('--device', action='store_true', help='design another device like that of the ready scene')
    parser.add_argument('-o', '--out', type=Path, default=Path('out'), metavar='DIR')
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.device:
        device = designed('complete', 45.0, options.out, steps=4800, draws=4, wide=1.3)
    else:
        device = Device.read(ready_scene('demultiplexer').with_name('demultiplexer.csv'))
        written(options.out / 'demultiplexer_trim.csv', ('copy', 'model', 'built_dB', 'trimmed_dB', 'chi'), trim_table(device))
        written(options.out / 'demultiplexer_copies.csv', ('copies', 'of', 'reached_dB', 'above_30_percent', 'above_20_percent'),
                copies_table(device, options.out))
    further = judged(device, FURTHER, SEED + 2)
    print(f'of {FURTHER} further copies {(further > 30).mean():.1%} keep 30 dB, {(further > 20).mean():.1%} keep 20 dB')


if __name__ == '__main__':
    main()
