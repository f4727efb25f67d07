"""A plan: the models that could answer a question about a lattice, from the simplest on, each with its error.

    conventional linear    D0: frozen bond directions
    complete linear        D0 + D*: the static forces turn with the bonds
    nonlinear              the law itself, in time steps

The error of a model is its difference from the most complete one in the wanted quantity: the peak of a response, or a waveform.
The plan takes the simplest model whose error, including the uncertainty of this estimate, meets the tolerance.  docs/measured.md
gives the cost of time steps of each order.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import positive
from ..stiffness.bond import Model

LONGEST_STEP = 0.5
"""Largest time step of a run, as a fraction of the limit 2/omega_max of Verlet.  The frequency error of a vibration at omega_max
is then 13 % larger than in proportion to the square of the step, and with longer steps the difference grows fast."""
STEP_ERROR_FRACTION = 0.6
"""Fraction of the tolerance allotted to the error of time steps; the rest is for its uncertainty, in bursts half of the rest."""


@dataclass(frozen=True)
class Method:
    """A model, how it is run, and its error.

    Attributes
    ----------
    name : str
    algorithm : str
        How the model is computed, in words.
    error : float
        Difference from the most complete method in the wanted quantity, relative to what `Plan.measure` names.
    doubt : float
        Relative uncertainty of the error.
    model : {'complete', 'conventional'}
    dt : float, optional
        Time step in ms; None where no time steps are made.
    order : int
        Order of the time steps.
    """

    name: str
    algorithm: str
    error: float
    doubt: float = 0.0
    model: Model = 'complete'
    dt: float | None = None
    order: int = 2

    @property
    def at_most(self) -> float:
        """The error at the upper end of its uncertainty."""
        return self.error * (1 + self.doubt)


@dataclass(frozen=True)
class Plan:
    """The methods for one quantity and the tolerance for it.

    Attributes
    ----------
    quantity : str
        The wanted quantity, in words.
    measure : str
        What the errors are relative to, in words.
    tolerance : float
    methods : tuple of Method
        Methods, from the simplest to the most complete.
    evidence : tuple of str
        Sentences that say where the errors come from.
    """

    quantity: str
    measure: str
    tolerance: float
    methods: tuple[Method, ...]
    evidence: tuple[str, ...]

    def __post_init__(self) -> None:
        positive('tolerance', self.tolerance)

    @property
    def choice(self) -> Method:
        """The simplest method that meets the tolerance; ValueError if none does."""
        for method in self.methods:
            if method.at_most <= self.tolerance:
                return method
        best = min(self.methods, key=lambda method: method.error)
        raise ValueError(f'{self.quantity}: no model here reaches an error of {percent(self.tolerance)}; the best, {best.name}, '
                         f'has an error of {percent(best.error)}; allow a larger one '
                         '(--tolerance on the command line)' + ''.join(f'; {fact}' for fact in self.evidence))

    @property
    def first(self) -> str:
        """The chosen method and its error, in one line."""
        return (f'{self.quantity}: the {self.choice.name} model is enough ({self.choice.algorithm}); its error is at most '
                f'{percent(self.choice.at_most)}.')

    def report(self) -> str:
        """The methods as a table, the choice and its reasons, as text for the terminal."""
        choice = self.choice
        width = max(len(method.name) for method in self.methods)
        return '\n'.join([f'{self.quantity}, to {percent(self.tolerance)}{self.measure and f" of {self.measure}"}',
                          f'  {"model":{width}}  {"error":>9}  {"at most":>9}',
                          *(f'  {method.name:{width}}  {percent(method.error):>9}  {percent(method.at_most):>9}'
                            + '  <- recommended' * (method is choice) for method in self.methods),
                          *(f'  {fact[0].upper()}{fact[1:]}.' for fact in self.evidence)])


def percent(share: float) -> str:
    """A relative error as text, with two digits."""
    if share == float('inf'):
        return 'unbounded'
    if share == 0:
        return 'round-off'
    return f'{100 * share:.2g} %' if share < 1 else f'{100 * share:.0f} %'
