"""Compiled functions are kept on disk: what happens to damaged files, and when a source has changed."""

import ast
import pickle
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest


@pytest.fixture
def doubling(tmp_path, monkeypatch):
    """A function that is compiled, by `magphonon` or by numba itself, as a new process would do it."""
    numba = pytest.importorskip('numba')
    from magphonon.dynamics.machine_code import compiled

    monkeypatch.setattr(numba.config, 'CACHE_DIR', str(tmp_path))
    source = tmp_path / 'doubling.py'
    source.write_text('def double(x):\n    return 2 * x\n', encoding='utf-8')

    def compile_by(numba_itself=False):
        module = module_from_spec(spec_from_file_location('doubling', source))
        module.__spec__.loader.exec_module(module)
        monkeypatch.setitem(sys.modules, 'doubling', module)  # where numba looks for it when it finds what it has compiled
        signature = numba.types.int64(numba.types.int64)
        return numba.njit(signature, cache=True)(module.double) if numba_itself else compiled(signature, 'double')(module.double)

    return compile_by


@pytest.mark.parametrize('numba_itself', [False, True])
@pytest.mark.parametrize('kind', ['nbi', 'nbc'])
def test_a_damaged_file_of_what_numba_has_compiled_is_written_anew(doubling, kind, numba_itself, tmp_path):
    doubling(numba_itself)
    (file,) = tmp_path.rglob(f'*.{kind}')
    file.write_bytes(b'_ is no pickle')
    if numba_itself:  # the control: it ends there
        with pytest.raises(pickle.UnpicklingError):
            doubling(numba_itself)
        return
    anew, found = doubling(), doubling()
    assert [anew.call(2), found.call(2)] == [4, 4]
    assert [anew.kept, found.kept] == [False, True]


@pytest.mark.skipif(not Path('/proc').exists(), reason='a system without a folder in which nobody can write')
def test_where_no_folder_can_be_written_each_process_compiles_for_itself(monkeypatch):
    numba = pytest.importorskip('numba')
    from magphonon.dynamics.machine_code import compiled

    monkeypatch.setattr(numba.config, 'CACHE_DIR', '')
    monkeypatch.setenv('HOME', '/proc')
    monkeypatch.delenv('XDG_CACHE_HOME', raising=False)
    names, signature = {}, numba.types.int64(numba.types.int64)
    exec(compile('def double(x):\n    return 2 * x\n', '/proc/doubling.py', 'exec'), names)
    with pytest.raises(RuntimeError, match='no locator available'):  # the control
        numba.njit(signature, cache=True)(names['double'])
    made = compiled(signature, 'double')(names['double'])
    assert (made.call(2), made.kept) == (4, False)


def test_a_change_of_any_file_with_compiled_functions_is_noticed(doubling, monkeypatch):
    machine_code = pytest.importorskip('magphonon.dynamics.machine_code', exc_type=ImportError)
    doubling()
    assert doubling().kept
    monkeypatch.setattr(machine_code, 'SOURCES', 'of another version')
    assert not doubling().kept
    assert doubling().kept


def test_the_stamp_is_of_every_file_that_goes_into_compiled_functions():
    machine_code = pytest.importorskip('magphonon.dynamics.machine_code', exc_type=ImportError)
    folder, reached = Path(machine_code.__file__).parent, {'compiled_steps.py'}
    for _ in range(5):  # as many as there are; law_pieces.py needs bond_increments.py for types only
        modules = [node.module for name in reached for node in ast.walk(ast.parse((folder / name).read_text(encoding='utf-8')))
                   if isinstance(node, ast.ImportFrom) and node.level == 1 and 'bond_increments' not in node.module]
        reached |= {f'{module}.py' for module in modules}
    assert reached == set(machine_code.FILES)
