"""Do the tests notice wrong physics?  Small wrong edits of the package, one at a time, and the share that a test kills.

    python benchmarks/mutants.py stiffness/matrices dynamics/engine --sample 8

Works on a copy of the tree.  The tests of a room first run unmutated, and must pass.  Then each mutant of the room's modules
meets them, those of its own file first and the quick before the slow, until one fails; what survives may meet those of `--more`
also.  Killed is also what takes much more time or memory than the unmutated package, as endless loops do.  Edits that change
numbers are drawn: operators, comparisons, constants, indices, dropped terms, swapped arguments, lost `abs`; no words, no types,
no errors.  A survivor is not always a gap: some edits change only the speed, or a tolerance that nothing comes near.

Each mutant runs in a forked process, so libraries are imported once.  Why not mutmut: it wraps each function in a switch, which
numba cannot compile, and leaves constants of modules alone, such as SHELL_WIDTH.
"""

import argparse
import ast
import compileall
import contextlib
import importlib
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from pathlib import Path
from py_compile import PycInvalidationMode

import hypothesis
import pytest

ROOT = Path(__file__).resolve().parents[1]
FORK = multiprocessing.get_context('fork')
LIBRARIES = ('ase.build', 'hypothesis.strategies', 'matplotlib.pyplot', 'numba', 'phonopy', 'scipy.integrate', 'scipy.optimize',
             'scipy.sparse.linalg', 'scipy.spatial')
MEMORY = 6 << 30
"""Bytes of address space for a mutant; beyond it, it ends with MemoryError and counts as killed."""
SWAPS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.MatMult: ast.Mult, ast.Pow: ast.Mult,
         ast.Lt: ast.GtE, ast.LtE: ast.Lt, ast.Gt: ast.LtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
         ast.And: ast.Or, ast.Or: ast.And}
NOT_SWAPPED = ('isinstance', 'range', 'zip', 'np.add', 'np.multiply', 'np.maximum', 'np.minimum', 'np.hypot', 'np.array_equal')
"""Calls whose swapped arguments would only be a crash, or the same."""
CHECKED = ('assert', 'AssertionError', 'Failed: DID NOT RAISE')
"""How the words begin of a test that has compared; others end by an error in the mutant itself."""


def wrong_edits(source):
    """All edits of a source as (line, old text, first and last byte, new text), words and types left alone."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in _numbers(ast.parse(source)):
        first, last = starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
        for new in _wrong(node):
            yield node.lineno, source.encode()[first:last].decode(), first, last, f'({ast.unparse(new)})'


def _numbers(node):
    """The node and all below it that compute: not annotations, decorators, texts, or what is raised."""
    if hasattr(node, 'lineno'):
        yield node
    for name, value in ast.iter_fields(node):
        if name in ('annotation', 'returns', 'decorator_list'):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr | ast.Raise):
                yield from _numbers(child)


def _wrong(node):
    """Wrong versions of a node."""
    if isinstance(node, ast.BinOp) and type(node.op) in SWAPS and not _is_text(node):
        yield ast.BinOp(node.left, SWAPS[type(node.op)](), node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            yield node.left  # a term is lost
    elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in SWAPS:
        yield ast.Compare(node.left, [SWAPS[type(node.ops[0])]()], node.comparators)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(SWAPS[type(node.op)](), node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        yield node.operand
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield ast.Constant(2 * node.value if type(node.value) is float and node.value else node.value + 1)
    elif isinstance(node, ast.Call) and not node.keywords and isinstance(node.func, ast.Name) and node.func.id in ('abs', 'max'):
        yield node.args[0]
    elif isinstance(node, ast.Call) and len(node.args) == 2 and not any(map(_is_text, node.args)) \
            and ast.unparse(node.func) not in NOT_SWAPPED:
        yield ast.Call(node.func, node.args[::-1], node.keywords)


def _is_text(node):
    return any(isinstance(part, ast.JoinedStr) or (isinstance(part, ast.Constant) and isinstance(part.value, str))
               for part in ast.walk(node))


class Watch:
    """A plugin of pytest that orders the tests and keeps how long each took and which one failed."""

    def __init__(self, own, seconds):
        self.own, self.seconds, self.took, self.failed, self.checked = own, seconds, {}, None, False

    def pytest_collection_modifyitems(self, items):
        items.sort(key=lambda item: (item.path.name != self.own, self.seconds.get(item.nodeid, 0)))

    def pytest_runtest_logstart(self, nodeid):
        if nodeid in self.seconds:  # or the signal ends the process; compiling takes a minute
            signal.setitimer(signal.ITIMER_PROF, 10 * self.seconds[nodeid] + 60)

    def pytest_runtest_logreport(self, report):
        self.took[report.nodeid] = self.took.get(report.nodeid, 0) + report.duration
        if report.failed and self.failed is None:
            crash = getattr(report.longrepr, 'reprcrash', None)
            words = crash.message.splitlines()[0][:80] if crash else 'no words'
            self.failed = f'{report.nodeid}: {words}'
            self.checked = words.startswith(CHECKED)

    def pytest_collectreport(self, report):
        if report.failed and self.failed is None:
            self.failed = f'{report.nodeid} (collecting)'


def trial(tree, tests, own='', seconds=None):
    """Run tests in a process of its own until one fails.

    Parameters
    ----------
    tree : Path
    tests : list of str
        For pytest, relative to the tree.
    own : str
        Name of the file whose tests come first.
    seconds : dict of str to float, optional
        How long each took before: the quick come first, and none may take much longer.

    Returns
    -------
    took : dict of str to float
    failed : str or None
        The test that failed, or what ended the process.
    checked : bool
        Whether it failed by a comparison, not by an error of the mutant.
    """
    receiver, sender = FORK.Pipe(duplex=False)
    child = FORK.Process(target=_run, args=(sender, tree, tests, Watch(own, seconds or {})))
    child.start()
    sender.close()
    try:
        if receiver.poll(seconds and 10 * sum(seconds.values()) + 600):  # who waits for ever needs no processor time
            return receiver.recv()
        return {}, 'it waits for ever', False
    except EOFError:
        return {}, 'a crash, or a test that takes much longer', False
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.join()


def _run(sender, tree, tests, watch):
    os.setsid()  # what the tests start ends with them
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    log = os.open(tree.parent / 'log', os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
    for stream in (0, 1, 2):
        os.dup2(log, stream)
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    os.environ |= {'PYTHONPATH': str(tree), 'PYTHONDONTWRITEBYTECODE': '1', 'NUMBA_CACHE_DIR': str(tree / '.numba')}
    hypothesis.settings.register_profile('mutants', derandomize=True, database=None, deadline=None,
                                         phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate])  # nothing is shrunk
    code = pytest.main(['-x', '-q', '-n', '0', '-p', 'no:cacheprovider', '--hypothesis-profile=mutants',
                        '-W', 'ignore::pytest.PytestAssertRewriteWarning', *tests], plugins=[watch])
    package = sys.modules.get('magphonon')
    if package and not package.__file__.startswith(str(tree)):
        watch.failed = f'the wrong package was tested: {package.__file__}'
    sender.send((watch.took, watch.failed or (f'pytest ended with code {int(code)}' if code else None), watch.checked))
    sender.close()


class Unmutated:
    """How long tests take without a mutant, measured once for each choice of tests."""

    def __init__(self, tree):
        self.tree, self.known = tree, {}

    def __call__(self, tests):
        """Seconds that each test takes.

        Raises
        ------
        SystemExit
            If one fails: then it would kill every mutant.
        """
        key = tuple(tests)
        if key not in self.known:
            took, failed, _ = trial(self.tree, tests)
            if failed or not took:
                log = (self.tree.parent / 'log').read_text(encoding='utf-8')[-5000:]
                raise SystemExit(f'without a mutant: {failed or "no test was found in " + ", ".join(tests)}\n{log}')
            self.known[key] = took
        return self.known[key]


def killed_by(tree, tests, own, unmutated):
    """The test that fails in the mutated tree and whether it does by a comparison, or None."""
    _, failed, checked = trial(tree, tests, own, unmutated(tests))
    return (failed, checked) if failed else None


def sampled(tree, module, options):
    """Edits drawn from a module: file, line, old and new text, new source, lists of tests that it meets one after the other."""
    file = tree / 'magphonon' / f'{module}.py'
    source = file.read_text(encoding='utf-8')
    edits = list(wrong_edits(source))
    quick = ['-m', 'not slow and not long and not peer']
    meets = [[*quick, f'tests/{Path(module).parent}'], *([[*quick, *options.more]] if options.more else [])]
    for line, old, first, last, new in random.Random(f'{options.seed} {module}').sample(edits, min(options.sample, len(edits))):
        yield file, line, old, new, (source.encode()[:first] + new.encode() + source.encode()[last:]).decode(), meets


def main():
    """Mutate, test and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('modules', nargs='+', help='as stiffness/matrices')
    parser.add_argument('--sample', type=int, default=8, help='mutants of each module (8)')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--more', nargs='*', default=[], help='tests for what survives, as tests/test_methods_compared.py')
    options = parser.parse_args()
    for library in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(library)
    table = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / 'tree'
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns('.*', '__pycache__'))
        compileall.compile_dir(tree, quiet=1, invalidation_mode=PycInvalidationMode.CHECKED_HASH)  # never that of a mutant
        unmutated = Unmutated(tree)
        drawn = {module: sampled(tree, module, options) for module in options.modules}
        for name, mutants in drawn.items():
            killers = []
            for file, line, old, new, mutant, meets in mutants:
                for tests in meets:
                    unmutated(tests)
                source = file.read_text(encoding='utf-8')
                file.write_text(mutant, encoding='utf-8')
                killer = next(filter(None, (killed_by(tree, tests, f'test_{file.name}', unmutated) for tests in meets)), None)
                file.write_text(source, encoding='utf-8')
                killers.append(killer)
                edit = f'{file.relative_to(tree)}:{line}: {old} -> {new}'
                print(f'killed    {edit}   [{killer[0]}]' if killer else f'SURVIVED  {edit}', flush=True)
            dead = list(filter(None, killers))
            table.append(f'| {name} | {len(killers)} | {len(dead)} | {sum(checked for _, checked in dead)} |')
    print('\n| module | mutants | killed | of these by a comparison |\n|---|---|---|---|', *table, sep='\n')


if __name__ == '__main__':
    main()
