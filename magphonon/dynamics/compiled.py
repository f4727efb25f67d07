"""Whether compiled kernels can run with the numba that is installed."""

from __future__ import annotations

from functools import cache
from warnings import warn

import numpy as np


@cache
def can_compile() -> bool:
    """Whether kernels can be compiled; if the numba that is installed does not work, this warns once."""
    try:
        from numba import config

        if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]  numba sets it from the environment
            raise RuntimeError('NUMBA_DISABLE_JIT is set')
        from .kernels_numba import follow

        u, x = np.zeros((2, 1)), np.zeros((1, 3))
        follow(None, u, u, u, np.ones(1), x, x.copy(), True)  # the smallest kernel: if it cannot be compiled, none can
    except Exception as error:  # other versions of numba may raise anything
        warn(f'compiled steps cannot be loaded with the numba that is installed ({error!r}); long runs go on in NumPy, which '
             "takes several times as long: pip install -U 'magphonon[fast]'", stacklevel=4)
        return False
    return True
