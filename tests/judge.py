"""Whether a command ended as it should: an answer or a refusal in own words, and never anything in between."""

import csv
import re
import signal
import tomllib
import warnings
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO

import numpy as np

from magphonon.cli import main
from magphonon.scenes.scene import Scene

TABLES = '|'.join(Scene.model_fields)
NAMED = re.compile(rf'(?<![\w.])(({TABLES})(\.\w|\[| has | lacks | must | names |:)|title)|\[({TABLES})[\].]|--\w|no key'
                   r'|lacks the|is not TOML|is not a scene')
"""What a refusal of a scene says beyond the name of the file: a key, a table or an option, or that it is none."""
FOREIGN = re.compile(r'Traceback|pydantic|numpy|np\.float|ufunc|dtype|NoneType|zip\(\)|SVD|did not converge|Optimal parameters'
                     r'|allowed size|object at|Errno|ParseFatal'
                     r'|codec|index \d|out of bounds|broadcast|singular matrix|cannot convert|Number of rows|array\(')
"""What other people's complaints look like."""
NOT_A_NUMBER = re.compile(r'(?<![A-Za-z])(nan|inf)(?![A-Za-z])', re.IGNORECASE)
VALUELESS = {'slopes', 'xi_centre', 'omega_centre', 'xi_change'}
"""Arrays in which NaN says that there is no value, as has the slope of a frequency of zero, whose columns begin with std_."""
SLOW = 'no answer in time'


class TooSlow(BaseException):
    """No answer within the time of a case; no Exception, which a command might take for its own."""


@dataclass(frozen=True)
class Verdict:
    """How a command ended.

    Attributes
    ----------
    faults : list of str
        Empty for a sound end.
    status : int or None
        None where it did not end by itself.
    words : str
        What it said, on both streams.
    """

    faults: list
    status: int | None
    words: str = ''


@contextmanager
def limits(seconds, memory):
    """Time of the processor, which other processes on the machine do not shorten, and memory beyond what the process has."""
    import resource

    def strike(*_):
        raise TooSlow

    with open('/proc/self/statm') as statm:
        present = int(statm.read().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGPROF, strike)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    resource.setrlimit(resource.RLIMIT_AS, (present + memory, hard))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, before)


def judged(arguments, inputs, out, seconds=20, memory=3 * 2**30):
    """Run a command in this process and judge how it ends.

    Parameters
    ----------
    arguments : list of str
    inputs : list of pathlib.Path
        Its files, the scene last.
    out : pathlib.Path
        The directory of its results, in a directory of its own.
    seconds, memory : float
        Of the processor; bytes.

    Returns
    -------
    Verdict
    """
    said, complaints = StringIO(), StringIO()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter('always')
        try:
            with limits(seconds, memory), redirect_stdout(said), redirect_stderr(complaints):
                status = main.main(arguments)
        except TooSlow:
            return Verdict([SLOW], None)
        except SystemExit as ended:
            status = ended.code
        except BaseException as error:
            return Verdict([f'traceback: {type(error).__name__}: {str(error)[:200]}'], None)
    faults = [f'warning: {one.message}'[:200] for one in warned if issubclass(one.category, RuntimeWarning)]
    if status not in (0, 2) and (status != 1 or arguments[0] != 'check'):
        faults.append(f'exit status {status}')
    if status == 2:
        faults += unclear(complaints.getvalue(), inputs, out)
    elif NOT_A_NUMBER.search(said.getvalue()):
        faults.append('nan or inf in the report')
    if status == 0:
        faults += [f'{file.name} holds what is no number' for file in out.rglob('*') if holds_no_number(file)]
    elif out.exists() and any(out.iterdir()):
        faults.append(f'left {sorted(file.name for file in out.iterdir())} behind')
    faults += [f'left {file.name} behind' for file in out.parent.rglob('*partial*')]
    return Verdict(faults, status, said.getvalue() + complaints.getvalue())


def unclear(error, inputs, out):
    """What a refusal lacks: own words, and the file or, where a scene is TOML, the key, the table or the option at fault."""
    faults = [] if 'magphonon: ' in error or 'magphonon ' in error else [f'no message: {error[:200]!r}']
    if found := FOREIGN.search(error):
        faults.append(f'foreign words {found.group()!r}: {error[:300]}')
    *tables, scene = inputs
    bare = error.replace(f'{scene}', '')
    about_a_table = any(str(file) in error for file in (*tables, out))
    if is_toml(scene) and not about_a_table and not NAMED.search(bare):
        faults.append(f'names no key: {error[:300]}')
    if not is_toml(scene) and str(scene) not in error and not about_a_table:
        faults.append(f'names no file: {error[:300]}')
    return faults


def is_toml(file):
    """Whether it is a scene, so far as TOML goes, and no table of forces."""
    try:
        tomllib.loads(file.read_text(encoding='utf-8-sig'))
    except (ValueError, RecursionError):
        return False
    return file.suffix == '.toml'


def holds_no_number(file):
    """Whether a result holds infinity, or NaN where it does not mean that there is no value."""
    if file.suffix == '.npz':
        with np.load(file) as arrays:
            return any(np.isinf(array).any() or (name not in VALUELESS and np.isnan(array).any())
                       for name, array in arrays.items() if np.issubdtype(array.dtype, np.inexact))
    if file.suffix == '.csv':
        with open(file, newline='', encoding='utf-8') as lines:
            return any(cell.lstrip('+-') in ('nan', 'inf') and not (name.startswith('std_') and cell == 'nan')
                       for row in csv.DictReader(lines) for name, cell in row.items())
    return file.suffix in ('.txt', '.yaml', '.toml') and bool(NOT_A_NUMBER.search(file.read_text(encoding='utf-8')))
