"""The script of mutants names texts of the package and tests: they must be there."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

pytest.importorskip('resource')  # not on every system
ROOT = Path(__file__).parents[1]
SPEC = spec_from_file_location('mutants', ROOT / 'benchmarks' / 'mutants.py')
mutants = module_from_spec(SPEC)
SPEC.loader.exec_module(mutants)


def test_each_edit_that_once_survived_can_be_made_and_has_its_test():
    for file, _, _, _, mutant, [[*_, tests]] in mutants.known(ROOT):
        assert mutant != file.read_text(encoding='utf-8')
        assert (ROOT / tests.split('::')[0]).exists()


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
