"""Design: the paper's prototype found again from its frequencies, gaps found in the zone, and what cannot be had."""

import tomllib

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.bands import zone_map
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.main import main
from magphonon.design import BandEdge, Objective
from magphonon.design.inverse import foundation_for, spacings_for
from magphonon.design.scatter import Slope
from magphonon.scenes.plans import HERTZ
from magphonon.scenes.scene import Scene, ready_scene, reference
from magphonon.scenes.tolerances import varied

M = np.array([0.5, 0, 0])


def scene(design, a=4.5824, foundation=None, lattice=None):
    """The ready scene with another law, foundation, lattice or [design]."""
    data = tomllib.loads(ready_scene('design').read_text())
    data['law']['a'] = a
    data['law']['b_N_m_a'] = 0.236895178822 * 0.01**a  # the prototype's force at 10 mm
    data['foundation'] = data['foundation'] if foundation is None else foundation
    data['lattice'] |= lattice or {}
    return Scene.model_validate(data | {'design': design})


def edge(frequency, spacings=(0.007, 0.02), cut_off=None, branch=1):
    return {'edge': {'point': 'M', 'branch': branch, 'frequency_Hz': frequency}, 'spacings_m': list(spacings)} | (
        {} if cut_off is None else {'cut_off_Hz': cut_off})


def test_prototype_is_found_from_its_cut_off_and_its_shear(tmp_path, capsys):
    """Its 10 mm and its pillars of 0.15 m, 19.6757 N/m; the frequencies are known to 1e-11, from a start 20 % off."""
    assert main(['design', '--verbose', str(ready_scene('design'))]) == 0
    shown = capsys.readouterr().out
    found = tomllib.loads(shown)  # ready to paste: what is not TOML is a comment
    assert_allclose(found['lattice']['spacing_m'], 0.01, rtol=1e-10)
    assert_allclose(found['foundation']['pillar']['height_m'], 0.15, rtol=1e-10)
    assert found['foundation']['pillar']['radius_m'] == 7.9375e-4
    assert '# 1 % more spacing changes branch 1 at M by -1.29 Hz' in shown
    assert 'branch 1 at M at 58.2327 Hz, cut-off 26.5507 Hz' in shown.splitlines()[0]
    # and the pasted scene has the bands of the paper
    data = tomllib.loads(ready_scene('prototype').read_text()) | found
    omega, _ = bloch_modes(Scene.model_validate(data).atoms(), [[0, 0, 0], M])
    paper = reference()['prototype']
    assert_allclose(omega[0, 0] / HERTZ, paper['gamma_Hz'], rtol=1e-9)
    assert_allclose(omega[1] / HERTZ, paper['M_complete_Hz'], rtol=1e-9)


def test_design_by_d0_alone_is_another_lattice():
    """The control: who takes 58.2 Hz for a conventional shear edge, sqrt(2 a f/(L m) + k/m), spaces the magnets 21 % wider."""
    paper = reference()['prototype']
    k, m, a = paper['k_eq'], paper['mass'], paper['a']
    f_over_L = ((2 * np.pi * paper['M_complete_Hz'][0]) ** 2 * m - k) / (2 * a)
    conventional = (paper['b'] / f_over_L) ** (1 / (a + 1))
    law = InversePower(paper['b'] * u.N * u.m**a, a)
    cell = lattices.triangular(conventional * u.m, m * u.kg)
    cell.calc = MagneticRepulsion(cell, law, foundation=k * u.N / u.m)
    asked = paper['M_complete_Hz'][0]
    assert_allclose(bloch_modes(cell, [M], 'conventional')[0][0, 0] / HERTZ, asked, rtol=1e-9)  # what he believes
    assert bloch_modes(cell, [M])[0][0, 0] / HERTZ < 0.8 * asked  # what he gets
    _, (design,) = scene(edge(paper['M_complete_Hz'][0], cut_off=paper['gamma_Hz'])).design.solve(scene(edge(58.0)))
    assert abs(design.spacing / u.m / conventional - 1) > 0.1


def test_springs_without_pillar_and_the_upper_branch(capsys, tmp_path):
    """M longitudinal of the prototype, 149.476338113 Hz, on springs given as a number."""
    wanted = scene(edge(149.476338113, branch=2), foundation={'stiffness_N_per_m': 19.675721234})
    k, (design,) = wanted.design.solve(wanted)
    assert_allclose(design.spacing / u.mm, 10, rtol=1e-10)
    assert_allclose(k / (u.N / u.m), 19.675721234, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(('a', 'share', 'beyond'), [(2.0, 0.05, 1.01), (2.5, 0.6, 3)])
def test_stability_is_a_constraint_where_it_is_active(a, share, beyond):
    """a < 3: w_M^2 = k/m - 2 (3 - a) f/(L m) falls to zero where the lattice buckles, at 2 (3 - a) f/L = k.  A frequency that
    only an unstable lattice has is refused; one just above zero is met just inside; 26 Hz and more cannot be reached."""
    b, k, m = 0.236895178822 * 0.01**a, 2.0, 7.07e-4
    verge = (2 * (3 - a) * b / k) ** (1 / (a + 1))
    cut_off = np.sqrt(k / m) / (2 * np.pi)

    def wanting(frequency):
        return scene(edge(frequency, (0.5 * verge, 2 * verge)), a, {'stiffness_N_per_m': k})

    plan = wanting(share * cut_off)
    _, (design,) = plan.design.solve(plan)
    expected = verge * (1 - share**2) ** (-1 / (a + 1))  # w^2 = (k/m) (1 - (verge/L)^(a+1))
    assert_allclose(design.spacing / u.m, expected, rtol=1e-9)
    assert design.needed < k * u.N / u.m

    widest = cut_off * np.sqrt(1 - 2 ** -(a + 1))
    plan = wanting(beyond * widest)
    with pytest.raises(ValueError, match='no spacing gives') as caught:
        plan.design.solve(plan)
    low, high = str(caught.value).rpartition('the value goes from ')[2].removesuffix(' Hz').split(' to ')
    # the verge is found to 1e-9, and the frequency there goes with the square root: 1e-4 of the cut-off
    assert float(low) < 1e-4 * cut_off
    assert_allclose(float(high), widest, rtol=1e-5)  # printed with six digits
    assert f'from {verge:.6g} to {2 * verge:.6g} m' in str(caught.value)


def test_lattice_that_buckles_throughout_is_refused_with_what_would_hold_it():
    """The square lattice needs 4 f(L0)/L0, least at the widest spacing."""
    plan = scene(edge(50.0, (0.008, 0.01)), foundation={'stiffness_N_per_m': 1.0}, lattice={'kind': 'square'})
    with pytest.raises(ValueError, match=r'buckles at every spacing from 0.008 to 0.01 m on a foundation of 1 N/m') as caught:
        plan.design.solve(plan)
    assert 'it needs at least 94.7581 N/m' in str(caught.value)  # 4 x 0.2368952/0.01


@pytest.mark.parametrize(('cut_off', 'refused'), [(40.0, True), (60.0, False)])
def test_cut_off_alone_keeps_the_spacing_if_the_lattice_holds(cut_off, refused):
    """The square lattice at 10 mm needs 94.758 N/m, a cut-off of 58.266 Hz."""
    plan = scene({'cut_off_Hz': cut_off}, lattice={'kind': 'square', 'spacing_m': 0.01})
    if refused:
        with pytest.raises(ValueError, match=r'raise the cut-off to 58\.26\d* Hz or more'):
            plan.design.solve(plan)
    else:
        k, (design,) = plan.design.solve(plan)
        assert_allclose(k / (u.N / u.m), 7.07e-4 * (2 * np.pi * cut_off) ** 2, rtol=1e-12)
        assert design.spacing == 10.0


HONEYCOMB = {'kind': 'honeycomb', 'relative_masses': [1.0, 3.0]}


def test_gap_of_a_lattice_of_two_masses(capsys, tmp_path):
    """Verified over the zone, on a mesh of another fineness."""
    plan = scene({'gap': {'above_branch': 2, 'width_Hz': 52.0}, 'spacings_m': [0.008, 0.012]},
                 foundation={'stiffness_N_per_m': 300.0}, lattice=HONEYCOMB)
    _, designs = plan.design.solve(plan)
    assert designs
    for design in designs:
        atoms = varied(plan, {'spacing': design.spacing / 12}).atoms()
        omega = zone_map(atoms, steps=60).omega.reshape(-1, 4)
        # the branches are flat where they end: a mesh misses the edge by the square of its step
        assert_allclose((omega[:, 2].min() - omega[:, 1].max()) / HERTZ, 52.0, rtol=1e-3)
        assert_allclose(design.value / HERTZ, 52.0, rtol=1e-10)


def test_gap_that_no_spacing_can_give_is_refused_with_the_reach():
    """Equal masses: the branches 2 and 3 of the honeycomb meet, whatever the spacing."""
    plan = scene({'gap': {'above_branch': 2, 'width_Hz': 5.0}, 'spacings_m': [0.008, 0.012]},
                 foundation={'stiffness_N_per_m': 300.0}, lattice={'kind': 'honeycomb'})
    with pytest.raises(ValueError, match=r'gap above branch 2: no spacing gives 5 Hz; where the lattice is stable') as caught:
        plan.design.solve(plan)
    low, high = map(float, str(caught.value).rpartition('the value goes from ')[2].removesuffix(' Hz').split(' to '))
    assert max(abs(low), abs(high)) < 1e-6


def test_value_met_twice_gives_both_spacings():
    """ln(L0/10)^2 = 0.01 at both sides of 10 mm."""
    law = scene(edge(58.0)).law.potential()

    def build(spacing):
        atoms = lattices.triangular(spacing, 1.0)
        atoms.calc = MagneticRepulsion(atoms, law)
        return atoms

    class Squared(Objective):
        def value_and_slope(self, rest):
            x = np.log(rest.system.atoms.cell.lengths()[0] / 10)
            return x**2, Slope(lengths=2 * x)

    first, second = spacings_for(build, Squared(), 0.01, (8.0, 13.0))
    assert_allclose([first.spacing, second.spacing], 10 * np.exp([-0.1, 0.1]), rtol=1e-10)


@pytest.mark.parametrize(('design', 'words'), [
    ({}, 'is empty; give cut_off_Hz'),
    (edge(58.0) | {'edge': {'point': 'X', 'branch': 1, 'frequency_Hz': 58.0}}, "must be one of G, M, K, not 'X'"),
    (edge(58.0, (0.02, 0.01)), 'design.spacings_m must be a range'),
    ({'edge': edge(58.0)['edge']}, 'spacings_m is the range'),
    ({'cut_off_Hz': 20.0, 'spacings_m': [0.01, 0.02]}, 'spacings_m is the range'),
    (edge(58.0) | {'gap': {'above_branch': 1, 'width_Hz': 5.0}}, 'only one spacing to meet them'),
])
def test_impossible_wish_is_refused_when_the_scene_is_read(design, words, tmp_path, capsys):
    text = ready_scene('design').read_text().partition('[design]')[0]
    rows = [f'{key} = {value}' for key, value in design.items() if not isinstance(value, dict)]
    tables = [f'[design.{key}]\n' + '\n'.join(f'{name} = {item!r}' for name, item in value.items())
              for key, value in design.items() if isinstance(value, dict)]
    (tmp_path / 'my.toml').write_text('\n'.join([text, '[design]', *rows, *tables]))
    assert main(['design', str(tmp_path / 'my.toml')]) == 2
    shown = capsys.readouterr()
    assert words in shown.err
    assert shown.out == ''


def test_cut_off_of_different_masses_is_refused():
    with pytest.raises(ValueError, match='which does not exist for particles of different masses'):
        scene({'cut_off_Hz': 20.0}, lattice=HONEYCOMB)


def test_scene_without_wishes_is_refused(tmp_path, capsys):
    assert main(['design', str(ready_scene('ideal'))]) == 2
    assert 'no table [design]' in capsys.readouterr().err


@pytest.mark.parametrize('seed', range(4))
def test_a_foundation_for_uniform_motion_asks_for_equal_masses(seed):
    rng = np.random.default_rng(seed)
    cell, cut_off = lattices.honeycomb(rng.uniform(5, 20), rng.uniform(0.1, 5)), rng.uniform(0.1, 2)
    cell.calc = MagneticRepulsion(cell, InversePower(b=1e3, a=4.0), foundation=foundation_for(cell, cut_off))
    cell.positions += 0.1, -0.2, 0  # all alike: they swing back at the cut-off
    assert_allclose(cell.get_forces() / cell.get_masses()[:, None], np.tile([-0.1, 0.2, 0], (2, 1)) * cut_off**2, rtol=1e-9)
    cell.set_masses(cell.get_masses() * [1, rng.uniform(1.01, 2)])
    with pytest.raises(ValueError, match='no motion is uniform'):
        foundation_for(cell, cut_off)


@pytest.mark.parametrize('seed', range(2))
def test_designs_beside_the_border_of_buckling_and_the_end_of_the_range(seed):
    """A row of magnets at X across itself: m omega^2 = k - 4 b/L^(a + 1), so spacing and border are closed forms.

    The first design is nearer to the border than any spacing that is scanned, the other in the last step of the scan.
    """
    rng = np.random.default_rng(seed)
    a, b, k, mass = rng.uniform([2, 1, 1, 0.3], [6, 9, 3, 2])
    border = (4 * b / k) ** (1 / (a + 1))

    def build(spacing):
        cell = lattices.chain(spacing, mass)
        cell.calc = MagneticRepulsion(cell, InversePower(b, a), foundation=k)
        return cell

    for L, between in ((border * (1 + rng.uniform(1e-4, 1e-3)), (0.6 * border, 2 * border)),
                       (1.5 * border, (0.7 * border, 1.5 * border * (1 + 1e-3)))):
        wanted = np.sqrt((k - 4 * b / L ** (a + 1)) / mass)
        [found] = spacings_for(build, BandEdge([0.5, 0, 0], below=1, sharp=np.inf), wanted, between)
        assert found.spacing == pytest.approx(L, rel=1e-9)
        assert between[0] < border < found.spacing < between[1]
