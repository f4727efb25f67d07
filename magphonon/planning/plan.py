"""No more model than a scene needs: rungs of modelling, each with its price and its error in what the scene asks for.

    conventional linear    D0: frozen bond directions
    complete linear        D0 + D*: the static forces turn with the bonds
    more shells            up to all neighbours, in infinite lattices
    nonlinear              the law itself, in time steps

The error of a rung is its difference from the richest one, in the quantity wanted: a band edge, the peak of a response,
a waveform.  It is estimated, not run; the plan takes the cheapest rung whose error, with the doubt about it, meets
the tolerance.

Prices are counted in multiplications, which no machine changes.
"""

from dataclasses import dataclass

ALL = 'all'
"""Shells of a rung with all neighbours."""
LAW = 16
"""Multiplications of one evaluation of the law, by its polynomial."""
EIGENSOLVE = 10
"""Multiplications of an eigen-solve over the cube of its size, vectors included."""


@dataclass(frozen=True)
class Rung:
    """A model, the cheapest method that answers by it, its price and its error.

    Attributes
    ----------
    name : str
    method : str
    cost : float
        In multiplications.
    error : float
        Estimated difference from the richest rung in the quantity wanted, relative as the plan says.
    doubt : float
        Relative uncertainty of this estimate.
    settings : dict
        What the run is told.
    """

    name: str
    method: str
    cost: float
    error: float
    doubt: float
    settings: dict

    @property
    def at_most(self):
        """The error at the upper end of the doubt."""
        return self.error * (1 + self.doubt)

    def meets(self, tolerance):
        """Whether the error is surely within the tolerance."""
        return self.at_most <= tolerance


@dataclass(frozen=True)
class Plan:
    """The rungs for one quantity and the tolerance for it.

    Attributes
    ----------
    quantity : str
        What is wanted.
    measure : str
        What its error is relative to.
    tolerance : float
    rungs : tuple of Rung
        From poor to rich.
    evidence : tuple of str
        Sentences that say where the estimates come from.
    cost : float
        Of the estimate itself, in multiplications.
    """

    quantity: str
    measure: str
    tolerance: float
    rungs: tuple
    evidence: tuple
    cost: float

    @property
    def choice(self):
        """The cheapest rung that meets the tolerance.

        Raises
        ------
        ValueError
            If none does.
        """
        good = [rung for rung in self.rungs if rung.meets(self.tolerance)]
        if not good:
            best = min(self.rungs, key=lambda rung: rung.error)
            raise ValueError(f'no model here gives {self.quantity} to {percent(self.tolerance)}: '
                             f'the best, {best.name}, is off by {percent(best.error)}; allow more')
        return min(good, key=lambda rung: rung.cost)

    def report(self):
        """The rungs as a table, the choice and its reasons, in words for a terminal."""
        choice = self.choice
        shown = [rung for k, rung in enumerate(self.rungs) if k in (0, 1, len(self.rungs) - 1) or rung is choice
                 or (k + 1 < len(self.rungs) and self.rungs[k + 1] is choice)]
        width = max(len(rung.name) for rung in shown)
        lines = [f'{self.quantity}, to {percent(self.tolerance)} of {self.measure}',
                 f'  {"model":{width}}  {"error":>9}  {"at most":>9}  multiplications']
        lines += [f'  {rung.name:{width}}  {percent(rung.error):>9}  {percent(rung.at_most):>9}  {rung.cost:8.1e}'
                  + '  <- enough' * (rung is choice) for rung in shown]
        dear = max(self.rungs, key=lambda rung: rung.cost)
        saved = f', {times(dear.cost / choice.cost)} cheaper than {dear.name}' if dear.cost > 2 * choice.cost else ''
        return '\n'.join([*lines, f'  Enough: {choice.name}, by {choice.method}{saved}.',
                          *(f'  {fact[0].upper()}{fact[1:]}.' for fact in self.evidence)])


def percent(share):
    """A relative error in words."""
    return f'{100 * share:.2g} %' if share < 1 else f'{100 * share:.0f} %'


def times(ratio):
    """A ratio in words, to two digits."""
    return f'{float(f"{ratio:.2g}"):,.0f} times' if ratio >= 10 else f'{ratio:.2g} times'


def force_cost(dim):
    """Multiplications of the force of one bond, by the law itself: it and the change of length, there and back."""
    return LAW + 4 * dim
