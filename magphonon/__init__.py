"""Static forces in repulsive lattices: stiffness D0 + D*, bands, waves; on ASE and phonopy (arXiv:1911.10410)."""

from importlib import import_module

__version__ = '0.1.0'

# The public names and where they live.  They are imported when first used, so that `import magphonon` stays light.
_HOME = {
    'InversePower': 'potentials',
    'Yukawa': 'potentials',
    'Tabulated': 'potentials',
    'Ring': 'magnets',
    'Cuboid': 'magnets',
    'Sphere': 'magnets',
    'magnet_law': 'magnets',
    'local_exponent': 'magnets',
    'out_of_plane_stiffness': 'magnets',
    'read_forces': 'fits',
    'fit_inverse_power': 'fits',
    'fit_spline': 'smoothlaws',
    'find_bonds': 'bonds',
    'explicit_bonds': 'bonds',
    'bond_stiffness': 'stiffness',
    'MagneticRepulsion': 'calculator',
    'AllNeighbours': 'allneighbours',
    'lattice_sum': 'latticesums',
    'particle_sums': 'latticesums',
    'reach': 'tails',
    'missing_stiffness': 'tails',
    'Bands': 'bands',
    'analytic_bands': 'bands',
    'band_path': 'bands',
    'group_velocities': 'bands',
    'sound_speeds': 'bands',
    'finite_displacements': 'phonons',
    'phonopy_bands': 'phonons',
    'extracted_dstar': 'phonons',
    'foundation_recovered': 'phonons',
    'displacement_errors': 'phonons',
    'in_phonopy_units': 'phononunits',
    'thermal_properties': 'phononunits',
    'write_band_yaml': 'bandfiles',
    'write_phonopy_params': 'bandfiles',
    'first_zone': 'zone',
    'zone_map': 'zone',
    'frequency_ratio': 'zone',
    'plot_bands': 'plotting',
    'plot_mode': 'plotting',
    'plot_zone': 'zoneplots',
    'plot_isofrequency': 'zoneplots',
    'plot_ratio': 'zoneplots',
    'foundation_needed': 'stability',
    'Verdict': 'stability',
    'verdict': 'stability',
    'spacing_held': 'buckling',
    'support_needed': 'buckling',
    'frequency_shifts': 'anharmonic',
    'relaxed': 'relaxation',
    'vibration': 'backbone',
    'plan_bands': 'bandladder',
    'plan_peak': 'peakladder',
    'plan_waveform': 'waveladder',
    'scene_plans': 'sceneplans',
    'DrivenVerlet': 'dynamics',
    'Diverged': 'cages',
    'Constant': 'drives',
    'Harmonic': 'drives',
    'ToneBurst': 'drives',
    'Recorder': 'recorder',
    'complex_bands': 'evanescent',
    'measured_decay': 'evanescent',
    'wavenumber_frequency': 'spectrum',
    'Displacements': 'vibrometer',
    'read_displacements': 'vibrometer',
    'write_displacements': 'vibrometer',
    'plot_wave': 'waveplots',
    'plot_snapshot': 'waveplots',
    'modes': 'linear',
    'frequency_response': 'linear',
    'propagate': 'propagation',
    'frequency_sensitivities': 'sensitivities',
    'response_sensitivities': 'sensitivities',
    'Tolerances': 'uncertainty',
    'frequency_spread': 'uncertainty',
    'response_spread': 'uncertainty',
    'spacings_for': 'design',
    'foundation_for': 'design',
    'read_scene': 'scenes',
    'ready_scene': 'scenes',
}
_MODULES = ('units', 'potentials', 'lattices', 'bonds', 'stiffness', 'calculator', 'bands', 'phonons', 'drives', 'dynamics',
            'sites', 'bursts', 'spectrum', 'waves', 'vibrometer', 'evanescent', 'frf', 'linear', 'accuracy', 'plotting',
            'scenes')

__all__ = sorted([*_HOME, *_MODULES])


def __getattr__(name):
    if name in _HOME:
        return getattr(import_module(f'.{_HOME[name]}', __name__), name)
    if name in _MODULES:
        return import_module(f'.{name}', __name__)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__():
    return sorted([*globals(), *__all__])
