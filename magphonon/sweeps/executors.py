"""The executors of a sweep: this process, other processes of this machine, Dask, MPI.

Nothing that needs numpy is imported here: a new process imports this file first, and then sets how many threads numpy starts.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from threading import Thread
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import Any

IN_FLIGHT = 64
"""Batches that are sent ahead to an executor that does not tell how many workers it has, and at least to a Dask cluster, which
starts more workers when it sees work waiting."""


class Here(Executor):
    """Computes in this process, one call after the other."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Processes(ProcessPoolExecutor):
    """Fresh processes of this machine, which end with this one however it ends."""

    def __init__(self, workers: int | None = None) -> None:
        # forked processes would inherit locks of threads that they do not have
        super().__init__(workers or usable_cores(), multiprocessing.get_context('spawn'), _prepare)

    def __exit__(self, kind: Any, value: Any, trace: Any) -> bool | None:
        """Wait for nothing if the sweep was interrupted."""
        if kind is not None:
            for process in list((self._processes or {}).values()):
                process.terminate()
            self.shutdown(cancel_futures=True)
        return super().__exit__(kind, value, trace)


def processes(workers: int | None = None) -> Callable[[], Processes]:
    """What makes a pool of processes, for `sweep(..., executor=processes(4))`; a pool whose process dies is made anew.

    Parameters
    ----------
    workers : int, optional
        By default one for each core that this process may use.
    """
    return partial(Processes, workers)


@contextmanager
def dask_workers(scheduler: str | None = None, workers: int | None = None) -> Iterator[Executor]:
    """An executor on the workers of Dask.

    Parameters
    ----------
    scheduler : str, optional
        Address of a running scheduler, such as 'tcp://10.0.0.1:8786'; by default workers on this machine.
    workers : int, optional
        How many of those are started on this machine.

    Raises
    ------
    OSError
        If no scheduler answers there.
    """
    from dask.distributed import Client

    own = {'n_workers': workers or usable_cores(), 'threads_per_worker': 1, 'dashboard_address': ':0'}
    try:
        client = Client(scheduler) if scheduler else Client(**own)
    except (OSError, ValueError) as error:
        raise OSError(f'no Dask scheduler answers at {scheduler} ({error}); start one with "dask scheduler"') from None
    with client:
        yield client.get_executor(pure=False)


@contextmanager
def mpi_ranks() -> Iterator[Executor | None]:
    """An executor on the ranks of `mpiexec` but the first one, which gets it; the others work, and get None when all is done.

    Raises
    ------
    ValueError
        If there is one rank only.
    """
    from mpi4py import MPI
    from mpi4py.futures import MPICommExecutor

    if MPI.COMM_WORLD.size < 2:
        raise ValueError('MPI has one rank, and the first one only leads; start more, as in "mpiexec -n 3 magphonon sweep ..."')
    with MPICommExecutor(MPI.COMM_WORLD, root=0) as executor:
        yield cast('Executor | None', executor)


def in_flight(executor: Executor) -> int:
    """How many batches keep all workers of an executor busy: two or more for each, as far as it tells how many there are."""
    if isinstance(executor, Here):
        return 1
    if (client := getattr(executor, '_client', None)) is not None:  # of Dask
        return max(IN_FLIGHT, 4 * sum(client.nthreads().values()))
    workers = getattr(executor, '_max_workers', None)  # of concurrent.futures and mpi4py
    return 2 * workers if isinstance(workers, int) and workers > 0 else IN_FLIGHT


def usable_cores() -> int:
    """Number of cores that this process may use, fewer than the machine has where a cluster allots them."""
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count() or 1


def _prepare():
    """In a new process: one thread for each library, a quiet end by Ctrl-C, and the end with the master."""
    os.environ.update(dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'NUMBA_NUM_THREADS'), '1'))
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    Thread(target=_end_with_master, daemon=True).start()


def _end_with_master():
    """A killed master cannot end its processes, and they would wait for work for ever."""
    if (master := multiprocessing.parent_process()) is not None:
        master.join()
        os._exit(1)
