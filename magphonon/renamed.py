"""Names that were replaced: each still works wherever it was exported, with a DeprecationWarning that says the new one."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

NAMES = {
    'Border': 'StabilityBoundary', 'Built': 'ParametricLattice', 'Change': 'StiffnessDerivative', 'Enough': 'ConvergedShells',
    'Extent': 'Localisation', 'FarFromLinear': 'StronglyNonlinear', 'FoundationNeeded': 'CriticalFoundation',
    'Growth': 'ParametricGrowth', 'LawChange': 'LawDerivative', 'Place': 'Dof', 'Softest': 'SoftMode',
    'SupportNeeded': 'CriticalSupport', 'Wall': 'PrescribedMotion',
    'border_over_exponents': 'stability_boundary_of_exponents', 'border_over_spacings': 'stability_boundary',
    'enough_shells': 'converged_shells', 'extents': 'localisation', 'foundation_needed': 'critical_foundation',
    'in_place': 'with_dofs', 'known_questions': 'observables', 'misread': 'suspect_units', 'modes_below': 'count_modes_below',
    'period': 'mode_frames', 'pumped_growth': 'parametric_growth', 'send': 'run_burst', 'site': 'burst_setup',
    'spacing_held': 'critical_spacing', 'support_needed': 'critical_support', 'without': 'with_vacancies',
}


def with_old(room: str, names: list[str], found: Callable[[str], Any]) -> Callable[[str], Any]:
    """The `__getattr__` of a room, `found`, that also finds old names of its exported `names`."""
    def attribute(name: str) -> Any:
        new = NAMES.get(name)
        if new not in names:
            return found(name)
        warnings.warn(f'{room}.{name} is called {new} now; the old name goes with version 0.3', DeprecationWarning, stacklevel=2)
        return found(new)

    return attribute
