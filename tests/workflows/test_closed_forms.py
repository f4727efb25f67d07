"""The closed forms that workflows compare with: they know nothing of the package, and have the numbers of the paper."""

import ast
from pathlib import Path

import numpy as np
import pytest

from magphonon.scenes.scene import reference
from workflows import closed_forms
from workflows.closed_forms import IDEAL, PROTOTYPE, along_the_row, oscillator, receptance, triangular


def test_they_import_nothing_of_the_package():
    tree = ast.parse(Path(closed_forms.__file__).read_text(encoding='utf-8'))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert {name.name if isinstance(node, ast.Import) else node.module for node in imports for name in node.names} == {
        'numpy', 'dataclasses'}
    assert not any(isinstance(node, ast.ImportFrom) and node.level for node in imports)


@pytest.mark.parametrize('dstar', [True, False])
def test_oscillator_and_lattice_of_the_paper(dstar):
    paper, model = reference(), 'complete' if dstar else 'conventional'
    for share, D in zip(paper['oscillator']['theta0_over_pi'], paper['oscillator']['D_yy' if dstar else 'D0_yy'], strict=True):
        assert oscillator(np.pi * share, dstar)[1, 1] == pytest.approx(D, rel=1e-12)
    assert np.sqrt(triangular(IDEAL, 0, np.pi, dstar)) == pytest.approx(paper['triangular'][f'M_{model}'], rel=1e-12)
    at_K = np.sqrt(triangular(PROTOTYPE, 4 * np.pi / 3, 2 * np.pi / 3, dstar)) / (2 * np.pi)
    assert at_K == pytest.approx(2 * [paper['prototype'][f'K_{model}_Hz']], rel=1e-9)
    assert along_the_row(PROTOTYPE, 'row', np.array([np.pi]), dstar)[0] / (2 * np.pi) == pytest.approx(
        paper['prototype'][f'M_{model}_Hz'], rel=1e-9)


def test_the_receptance_peaks_at_the_natural_frequency():
    omega = np.linspace(120, 160, 4001)
    assert omega[abs(receptance(0.0, omega, 1.0)).argmax()] == pytest.approx(np.sqrt(2e4), abs=0.02)
    assert receptance(0.0, 0.0, 1.0) == pytest.approx(1 / 2e4)


def test_the_gyrating_honeycomb_closes_its_gap_where_the_formula_says():
    a, k, D = 4.0, 6.0, 9.0
    closes = D / np.sqrt(4 * k + 2 * D)
    widths = [np.diff(closed_forms.middle_gap(a, k, closes + off))[0] for off in (-0.2, 0.0, 0.2)]
    assert abs(widths[1]) < 1e-9 < min(widths[0], widths[2])
    assert closed_forms.chern(a, k, closes - 0.2) == pytest.approx([1, 0, 0, -1], abs=1e-9)
    assert closed_forms.chern(a, k, closes + 0.2) == pytest.approx([1, -1, 1, -1], abs=1e-9)
