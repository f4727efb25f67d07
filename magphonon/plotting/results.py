"""What the pictures read of results whose rooms stand beside this one or above it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray


class Response(Protocol):
    """A frequency response: `magphonon.response.FrequencyResponse`."""

    @property
    def omega(self) -> NDArray[np.float64]: ...
    @property
    def response(self) -> NDArray[np.complex128]: ...


class Extent(Protocol):
    """How far modes reach: `magphonon.response.Extent`."""

    @property
    def frequencies_Hz(self) -> NDArray[np.float64]: ...
    @property
    def participation(self) -> NDArray[np.float64]: ...


class SpectralFunction(Protocol):
    """Unfolded bands: `magphonon.response.SpectralFunction`."""

    @property
    def q(self) -> NDArray[np.float64]: ...
    @property
    def density(self) -> NDArray[np.float64]: ...
    @property
    def modes(self) -> float: ...
    @property
    def frequencies_Hz(self) -> NDArray[np.float64]: ...


class Spread(Protocol):
    """Values with their uncertainty: `magphonon.design.Spread`."""

    @property
    def values(self) -> NDArray[np.float64]: ...
    @property
    def std(self) -> NDArray[np.float64]: ...
    @property
    def contributions(self) -> Mapping[str, NDArray[np.float64]]: ...


class Border(Protocol):
    """The foundation that a lattice needs: `magphonon.stability.Border`."""

    @property
    def over(self) -> str: ...
    @property
    def at(self) -> NDArray[np.float64]: ...
    @property
    def needed(self) -> NDArray[np.float64]: ...


class Line(Protocol):
    """A branch over the phase of a step: `magphonon.waves.Branch`."""

    @property
    def xi(self) -> NDArray[np.float64]: ...
    @property
    def omega(self) -> NDArray[np.float64]: ...


class Ridge(Line, Protocol):
    """A measured branch with its uncertainty: `magphonon.waves.Ridge`."""

    @property
    def sigma_xi(self) -> NDArray[np.float64]: ...
    @property
    def sigma_omega(self) -> NDArray[np.float64]: ...


class Spectrum(Line, Protocol):
    """A wavenumber-frequency map: `magphonon.waves.Spectrum`."""

    @property
    def power(self) -> NDArray[np.float64]: ...
    @property
    def peak(self) -> float: ...


class Wave(Protocol):
    """The wave of one polarisation along a row: `magphonon.waves.Wave`."""

    @property
    def motion(self) -> str: ...
    @property
    def spectrum(self) -> Spectrum: ...
    @property
    def branches(self) -> Mapping[tuple[str, str], Line]: ...
    @property
    def ridge(self) -> Ridge | None: ...


class MeasuredBranches(Ridge, Protocol):
    """Points of measured branches: `magphonon.waves.RidgePoints`."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def ridge(self) -> NDArray[np.int_]: ...
    @property
    def q(self) -> NDArray[np.float64]: ...
    @property
    def frequencies_Hz(self) -> NDArray[np.float64]: ...


class FittedBranches(Protocol):
    """A fit to measured branches: `magphonon.design.DispersionFit`."""

    @property
    def branches(self) -> tuple[int, ...]: ...
    @property
    def residuals(self) -> NDArray[np.float64]: ...


class Record(Protocol):
    """Displacements of some particles: `magphonon.waves.Displacements`."""

    @property
    def times(self) -> NDArray[np.float64]: ...
    @property
    def particles(self) -> NDArray[np.int_]: ...
    @property
    def displacements(self) -> NDArray[np.float64]: ...


class Passage(Protocol):
    """What a burst leaves behind: `magphonon.waves.Passage`."""

    @property
    def row(self) -> Record: ...
    @property
    def field(self) -> Record: ...


class Site(Protocol):
    """Where a burst enters a patch and where it is measured: `magphonon.waves.Site`."""

    @property
    def driven(self) -> NDArray[np.int_]: ...
    @property
    def row(self) -> NDArray[np.int_]: ...
