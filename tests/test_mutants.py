"""The mutants that the script draws are wrong versions of what computes, and of nothing else."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

pytest.importorskip('resource')  # not on every system
ROOT = Path(__file__).parents[1]
SPEC = spec_from_file_location('mutants', ROOT / 'benchmarks' / 'mutants.py')
mutants = module_from_spec(SPEC)
SPEC.loader.exec_module(mutants)


def test_edits_are_wrong_versions_of_what_computes():
    source = '''@f(1)
def g(x: int = 2):
    """3"""
    if x < 0:
        raise ValueError(f"{x + 1}")
    return abs(x) * 0.5
'''
    edits = {(old, new) for _, old, _, _, new in mutants.wrong_edits(source)}
    assert edits == {('2', '(3)'), ('x < 0', '(x >= 0)'), ('0', '(1)'), ('abs(x) * 0.5', '(abs(x) / 0.5)'), ('abs(x)', '(x)'),
                     ('0.5', '(1.0)')}
