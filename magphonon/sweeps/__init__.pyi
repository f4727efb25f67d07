from .dataset import (
    sweep as sweep,
)
from .evaluation import (
    Answer as Answer,
)
from .executors import (
    dask_workers as dask_workers,
    mpi_ranks as mpi_ranks,
    processes as processes,
)
from .grid import (
    axis_of as axis_of,
)
from .questions import (
    known_questions as known_questions,
)
