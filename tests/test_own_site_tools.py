"""Every tool takes particles of different strengths and springs: as it does the same lattice described by laws of its kinds.

The magnets of a honeycomb, of the strengths s_0 and s_1, repel by s_i s_j phi; so they do if the pairs of kinds have the laws
s_i s_j phi and all strengths are 1.  The control takes both for equally strong.
"""

import numpy as np
import pytest
from oracles import lattice

from magphonon import (
    InversePower,
    MagneticRepulsion,
    analytic_bands,
    complex_bands,
    critical_foundation,
    finite_displacements,
    frequency_response,
    group_velocities,
    lattices,
    modes,
    sound_speeds,
    verdict,
)
from magphonon.bands import band_path, cut_off, extracted_dstar
from magphonon.bands.bloch import bloch_modes
from magphonon.design.sensitivities import StiffnessDerivative, force_change, frequency_sensitivities, response_sensitivities
from magphonon.stability import critical_support, frequency_shifts, vibration
from magphonon.stiffness import elastic_moduli

B, A, STRENGTHS, SPRINGS = 6200.0, 4.5824, (1.2, 0.8), np.array([[0.3, 0.35], [0.4, 0.5]])
Q = np.array([[0.1, 0.2, 0.0], [0.4, 0.3, 0.0]])


def laws(s0, s1):
    return {(0, 0): InversePower(s0 * s0 * B, A), (0, 1): InversePower(s0 * s1 * B, A), (1, 1): InversePower(s1 * s1 * B, A)}


def cell(way, strengths=STRENGTHS, springs=SPRINGS):
    """The honeycomb by one of both ways, on springs or free."""
    atoms = lattice('honeycomb')
    atoms.set_tags([0, 1])
    atoms.set_masses([0.7, 0.9])
    given = {'laws': InversePower(B, A), 'strengths': strengths} if way == 'strengths' else {'laws': laws(*strengths)}
    atoms.calc = MagneticRepulsion(atoms, **given, foundation=springs, shells=2)
    return atoms


def patch(way, strengths=STRENGTHS):
    atoms = lattices.parallelogram(cell(way), 4, 4)
    kinds = (atoms.get_masses() > 0.8).astype(int)  # the patch has numbered its rim by tags
    atoms.set_tags(kinds)
    given = ({'laws': InversePower(B, A), 'strengths': np.array(strengths)[kinds]} if way == 'strengths'
             else {'laws': laws(*strengths)})
    atoms.calc = MagneticRepulsion(atoms, **given, foundation=SPRINGS[kinds])
    atoms.calc = atoms.calc.balanced(range(len(atoms)))
    return atoms


def push(atoms):
    force = np.zeros((len(atoms), 3))
    free = np.setdiff1d(np.arange(len(atoms)), atoms.constraints[0].index)
    force[free[len(free) // 2], :2] = 1e-4, 2e-4
    return force


def swinging(atoms):
    linear = modes(atoms)
    found = vibration(atoms, linear, 3, lambda w: 0.05 / abs(linear.shapes[3]).max())
    return np.append(found.omega, found.harmonics[0] ** 2)


def fully_said(atoms):
    said = verdict(atoms)
    return np.array([said.case.force, said.buckling.spring, said.buckling.needed, said.timestep_limit, said.supports.wave,
                     said.supports.central, said.buckling.spacing or 0.0, *said.displacements])


TOOLS = {
    'bands': (cell, lambda a: analytic_bands(a, band_path(a, npoints=5)).omega),
    'evanescent': (cell, lambda a: np.sort_complex(complex_bands(a, (0, 1, 0), [0.3]).xi[0][:2])),
    'velocities': (cell, lambda a: group_velocities(a, Q)[1]),
    'cut-off': (cell, lambda a: np.array(cut_off(a))),
    'sound': (lambda *way: cell(*way, springs=0.0), sound_speeds),
    'moduli': (lambda *way: cell(*way, springs=0.0), lambda a: elastic_moduli(a).stress),
    'D*': (cell, lambda a: extracted_dstar(finite_displacements(a), a)),
    'sensitivities': (cell, lambda a: frequency_sensitivities(a, Q, [StiffnessDerivative(law=force_change(a.calc.law))])[1]),
    'buckling': (lambda *way: cell(*way, springs=0.0), lambda a: np.array(critical_foundation(a)[0])),
    'supports': (cell, lambda a: np.array(critical_support(a))),
    'verdict': (cell, fully_said),
    'shifts': (patch, lambda a: frequency_shifts(a).curvature),
    'vibration': (patch, swinging),
    'response': (patch, lambda a: abs(frequency_response(a, push(a), np.array([0.5, 1.0]), 0.05, tolerance=1e-12).response)),
    'slopes': (patch, lambda a: abs(response_sensitivities(a, push(a), np.array([0.5]), 0.05,
                                                           [StiffnessDerivative(foundation=a.calc.foundation)])[1])),
}


@pytest.mark.parametrize('name', TOOLS)
def test_strengths_are_laws_of_kinds(name):
    build, tool = TOOLS[name]
    found, expected, control = (tool(build(*way)) for way in (('strengths',), ('kinds',), ('kinds', (1.2, 1.2))))
    scale = abs(expected).max()
    assert abs(found - expected).max() < 1e-7 * scale  # iterations of some tools end at 1e-9
    assert abs(found - control).max() > 1e-4 * scale


def test_sensitivities_are_the_slopes_of_frequencies():
    """Under all forces, and under the springs alone, each by its own part."""
    atoms, step = cell('strengths'), 1e-5
    changes = StiffnessDerivative(law=force_change(atoms.calc.law)), StiffnessDerivative(foundation=atoms.calc.foundation)
    slopes = frequency_sensitivities(atoms, Q, changes)[1]
    grown = {'law': lambda x: cell('strengths', np.sqrt(1 + x) * np.array(STRENGTHS)), 'springs': lambda x: cell(
        'strengths', springs=(1 + x) * SPRINGS)}
    for slope, other in zip(slopes, grown.values(), strict=True):
        ahead, behind = (bloch_modes(other(x), Q)[0] for x in (step, -step))
        assert abs((ahead - behind) / (2 * step) - slope).max() < 1e-8 * abs(slope).max()
