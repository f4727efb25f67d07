"""Whether compiled kernels can run with the numba that is installed."""

from __future__ import annotations

from functools import cache
from warnings import warn


@cache
def can_compile() -> bool:
    """Whether kernels can be compiled; if the numba that is installed does not work, this warns once."""
    try:
        from numba import config

        if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]  numba sets it from the environment
            raise RuntimeError('NUMBA_DISABLE_JIT is set')
        from .kernel import smallest

        smallest(1.0)  # if it cannot be compiled, nothing can
    except Exception as error:  # other versions of numba may raise anything
        warn(f"compiled steps cannot be loaded ({error!r}); long runs go through ASE's own loop, which takes many times as long: "
             'pip install -U numba', stacklevel=4)
        return False
    return True
