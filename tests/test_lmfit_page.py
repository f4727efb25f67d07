"""The blocks of the page "Fit anything with lmfit" run as they stand there, and find what they look for."""

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[1] / 'docs/reference/lmfit.md'
FIT, ROOT = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)
TRUE = {'force': 0.25, 'exponent': 4.4, 'foundation': 21.0, 'damping': 25.0}


def run(block):
    """The names that a block leaves behind, which begins with none."""
    exec(compile(block, 'a block of the page', 'exec'), names := {})
    return names


@pytest.mark.slow
def test_the_fit_finds_the_parameters_of_its_measurements():
    names = run(FIT)
    fit = names['fit']
    np.testing.assert_allclose(names['model'](**TRUE)[0], names['measured_bands'], atol=4 * 0.3)
    for name, true in TRUE.items():
        assert abs(fit.params[name].value - true) < 4 * fit.params[name].stderr < 0.1 * true
    assert 0.6 < fit.redchi < 1.5  # of 80 degrees of freedom: 1 +- 0.16


def test_the_spacing_for_a_frequency():
    """The prototype, with 10 mm and 58.23 Hz, is close by: 1 % more spacing lowers this frequency by about 1.6 Hz."""
    names = run(ROOT)
    assert names['spacing'] == pytest.approx(10.0, abs=0.05)
    assert names['shear_at_M'](names['spacing']) == pytest.approx(58.0, abs=1e-6)
    assert names['shear_at_M'](10.0) == pytest.approx(58.2327, abs=1e-3)
