"""A plan: the methods that could answer a question about a lattice, each with its predicted error and cost.

The models behind the methods, from the simplest to the most complete:

    conventional linear    D0: frozen bond directions
    complete linear        D0 + D*: the static forces turn with the bonds
    nonlinear              the law itself, in time steps

The error of a method is its difference from the most complete one in the wanted quantity: the peak of a response, a waveform.
The error is estimated without running the method; the plan takes the cheapest method whose error, including the uncertainty of
this estimate, meets the tolerance.

Costs are counted in multiplications, because these are the same on every machine; how long the time steps of each engine take is
in docs/measured.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import positive

LAW_COST = 16  # number of multiplications of one evaluation of the law, by its polynomial, counted in `dynamics.kernels_numba`
EIGENSOLVE = 10
"""Number of multiplications of an eigenvalue problem, vectors included, divided by the cube of its size: about 9 by the QR
algorithm (Golub and Van Loan, Matrix Computations, Sec. 8.3)."""
LONGEST_STEP = 0.5
"""Largest time step of a run, as a fraction of the limit 2/omega_max of Verlet.  The frequency error of a vibration at omega_max
is then 13 % larger than in proportion to the square of the step, and with longer steps the difference grows fast."""
STEP_ERROR_FRACTION = 0.6
"""Fraction of the tolerance allotted to the time-step error: what is left is its own uncertainty, half of it in bursts."""


@dataclass(frozen=True)
class Settings:
    """How a method is run.

    Attributes
    ----------
    model : {'complete', 'conventional'}
    dt : float, optional
        Time step in ms; None where no time steps are made.
    order : int
        Of the time steps.
    """

    model: str
    dt: float | None = None
    order: int = 2


@dataclass(frozen=True)
class Method:
    """A model with the cheapest algorithm that answers by it, its cost and its error.

    Attributes
    ----------
    name : str
    algorithm : str
    cost : float
        In multiplications.
    error : float
        Estimated difference from the most complete method in the wanted quantity, relative to what `Plan.measure` names.
    doubt : float
        Relative uncertainty of this estimate.
    settings : Settings
    """

    name: str
    algorithm: str
    cost: float
    error: float
    doubt: float
    settings: Settings

    @property
    def at_most(self) -> float:
        """The error at the upper end of its uncertainty."""
        return self.error * (1 + self.doubt)

    def meets(self, tolerance: float) -> bool:
        """Whether the error meets the tolerance even at the upper end of its uncertainty."""
        return self.at_most <= tolerance


@dataclass(frozen=True)
class Plan:
    """The methods for one quantity and the tolerance for it.

    Attributes
    ----------
    quantity : str
        What is wanted.
    measure : str
        What its error is relative to.
    tolerance : float
    methods : tuple of Method
        From the simplest to the most complete.
    evidence : tuple of str
        Sentences that say where the estimates come from.
    cost : float
        Cost of the estimate itself, in multiplications.
    """

    quantity: str
    measure: str
    tolerance: float
    methods: tuple[Method, ...]
    evidence: tuple[str, ...]
    cost: float

    def __post_init__(self) -> None:
        positive('tolerance', self.tolerance)

    @property
    def choice(self) -> Method:
        """The cheapest method that meets the tolerance; ValueError if none does."""
        good = [method for method in self.methods if method.meets(self.tolerance)]
        if not good:
            best = min(self.methods, key=lambda method: method.error)
            raise ValueError(f'no model here gives {self.quantity[0].lower()}{self.quantity[1:]} to {percent(self.tolerance)}: '
                             f'the best, {best.name}, is off by {percent(best.error)}; allow more '
                             '(--tolerance on the command line)' + ''.join(f'; {fact}' for fact in self.evidence))
        return min(good, key=lambda method: method.cost)

    def report(self) -> str:
        """The methods as a table, the choice and its reasons, as text for the terminal."""
        choice = self.choice
        shown = [method for k, method in enumerate(self.methods) if k in (0, 1, len(self.methods) - 1) or method is choice
                 or (k + 1 < len(self.methods) and self.methods[k + 1] is choice)]
        width = max(len(method.name) for method in shown)
        lines = [f'{self.quantity}, to {percent(self.tolerance)} of {self.measure}',
                 f'  {"model":{width}}  {"error":>9}  {"at most":>9}  multiplications']
        lines += [f'  {method.name:{width}}  {percent(method.error):>9}  {percent(method.at_most):>9}  {method.cost:8.1e}'
                  + '  <- recommended' * (method is choice) for method in shown]
        dear = max(self.methods, key=lambda method: method.cost)
        saved = f', {times(dear.cost / choice.cost)} cheaper than {dear.name}' if dear.cost > 2 * choice.cost else ''
        return '\n'.join([*lines, f'  Recommended: {choice.name}, by {choice.algorithm}{saved}.',
                          *(f'  {fact[0].upper()}{fact[1:]}.' for fact in self.evidence)])


def percent(share: float) -> str:
    """A relative error as text, with two digits."""
    if share == float('inf'):
        return 'unbounded'
    return f'{100 * share:.2g} %' if share < 1 else f'{100 * share:.0f} %'


def times(ratio: float) -> str:
    """A ratio as text, with two digits."""
    return f'{float(f"{ratio:.2g}"):,.0f} times' if ratio >= 10 else f'{ratio:.2g} times'


def force_cost(dim: int) -> int:
    """Number of multiplications for the force of one bond: the law, the bond length and the force components."""
    return LAW_COST + 4 * dim
