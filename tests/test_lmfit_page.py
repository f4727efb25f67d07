"""The block of the page "Fit anything with lmfit" runs as it stands there, and finds what its measurements were made with."""

import re
from pathlib import Path

import numpy as np

PAGE = Path(__file__).parents[1] / 'docs/reference/lmfit.md'
TRUE = {'force': 0.25, 'exponent': 4.4, 'foundation': 21.0, 'damping': 25.0}


def test_the_block_finds_the_parameters_of_its_measurements():
    [block] = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)
    exec(compile(block, 'the block of the page', 'exec'), names := {})
    fit = names['fit']
    np.testing.assert_allclose(names['model'](**TRUE)[0], names['measured_bands'], atol=4 * 0.3)
    for name, true in TRUE.items():
        assert abs(fit.params[name].value - true) < 4 * fit.params[name].stderr < 0.1 * true
    assert 0.6 < fit.redchi < 1.5  # of 80 degrees of freedom: 1 +- 0.16
