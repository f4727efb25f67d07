"""What the plans read of a scene, whose room stands above this one: `magphonon.scenes.Scene`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    import numpy as np
    from ase import Atoms
    from ase.dft.kpoints import BandPath
    from numpy.typing import NDArray

    from ..response.place import Place
    from ..waves.wave_source import Burst, Site


class FoundationTable(Protocol):
    """The table [foundation]."""

    @property
    def stiffness(self) -> float: ...


class ResponseTable(Protocol):
    """The table [frf]."""

    @property
    def omega(self) -> NDArray[np.float64]: ...
    @property
    def damping(self) -> float: ...


class BurstTable(Protocol):
    """The table [burst]."""

    @property
    def carriers_Hz(self) -> Sequence[float]: ...
    @property
    def directions_deg(self) -> Sequence[float]: ...
    @property
    def source(self) -> str: ...
    @property
    def names(self) -> Sequence[str]: ...
    def burst(self, k: int, site: Site) -> Burst:
        """Burst number k at a site."""
        ...


class PlanTable(Protocol):
    """The table [plan]."""

    @property
    def edge(self) -> str | None: ...
    @property
    def branch(self) -> int: ...
    @property
    def force_N(self) -> float | None: ...


class AskingScene(Protocol):
    """A scene that asks for quantities."""

    @property
    def title(self) -> str: ...
    @property
    def law(self) -> Any: ...  # one of several tables; those of one particle or of a file have no path, or shells of the class
    @property
    def lattice(self) -> Any: ...
    @property
    def laws_of_kinds(self) -> object: ...  # true where pairs of kinds have laws of their own
    @property
    def foundation(self) -> FoundationTable | None: ...
    @property
    def bands(self) -> object | None: ...
    @property
    def frf(self) -> ResponseTable | None: ...
    @property
    def burst(self) -> BurstTable | None: ...
    @property
    def plan(self) -> PlanTable | None: ...
    @property
    def single(self) -> bool: ...
    def cell(self) -> Atoms:
        """One cell without a calculator."""
        ...
    def atoms(self) -> Atoms:
        """One cell with its calculator."""
        ...
    def patch_atoms(self, model: str = 'complete') -> Atoms:
        """The patch with its calculator."""
        ...
    def shaken(self, model: str = 'complete') -> tuple[Atoms, Place, Place]:
        """The structure of the response, and where it is pushed and measured."""
        ...
    def band_path(self) -> BandPath:
        """The path of the bands."""
        ...
