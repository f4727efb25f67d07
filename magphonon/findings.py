"""Reports as lists of small functions, each of which finds one fact about a case and states it in words.

A report is a `Findings`. A function of the case is added by its decorator `check`, or by `remark` if the finding is never a
fault.  The words appear in the order of the functions in their file. One function may be the `answer`, whose words come first: a
command prints the answer and the faults, and with --verbose everything.

Examples
--------
>>> from magphonon.findings import Finding, Findings
>>> REPORT = Findings()
>>> @REPORT.check
... def balance(force):
...     return Finding(force, f'A force of {force} N is left.', fault=True) if force else None
>>> @REPORT.remark
... def size(force):
...     return 'One particle.'
>>> REPORT.lines(0.0), REPORT.lines(0.5), REPORT.find('balance', 0.5).fault
(['One particle.'], ['A force of 0.5 N is left.', 'One particle.'], True)
>>> REPORT.told(0.5), REPORT.told(0.0, verbose=True)
(['A force of 0.5 N is left.'], ['One particle.'])
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar


@dataclass(frozen=True)
class Finding:
    """What one function of a report found.

    Attributes
    ----------
    value : Any
        The result in mm, g, ms; None if it does not apply or was not computed.
    words : str
        A sentence or two, in SI units; empty if there is nothing to say.
    fault : bool
        Whether a run would fail, or its result be meaningless.
    unjudged : str
        What was omitted because it would take too long for so many particles.
    """

    value: Any = None
    words: str = ''
    fault: bool = False
    unjudged: str = ''


Judge: TypeAlias = Callable[[Any], Finding | str | Iterable[str] | None]
J = TypeVar('J', bound=Judge)


class Findings(dict[str, Judge]):
    """The functions of a report by name, in the order in which their words are printed.

    A function returns a `Finding`, or only its words: a sentence, several lines, or None if it has nothing to say.
    """

    def __init__(self) -> None:
        super().__init__()
        self.remarks: set[str] = set()  # names of those that are never a fault
        self.first = ''  # the name of the answer

    def check(self, judge: J) -> J:
        """Decorator that adds a function to the report, under its name."""
        self[judge.__name__] = judge  # pyright: ignore[reportAttributeAccessIssue]  functions have one
        return judge

    def remark(self, judge: J) -> J:
        """Decorator that adds a function whose words are never a fault; it is not run when only faults are wanted."""
        self.remarks.add(judge.__name__)  # pyright: ignore[reportAttributeAccessIssue]
        return self.check(judge)

    def answer(self, judge: J) -> J:
        """Decorator that adds the function whose words, in one line, answer the question of the command."""
        self.first = judge.__name__  # pyright: ignore[reportAttributeAccessIssue]
        return self.remark(judge)

    def find(self, name: str, case: Any) -> Finding:
        """What the function of this name finds about a case."""
        found = self[name](case)
        if isinstance(found, Finding):
            return found
        return Finding(words=found if isinstance(found, str) else '\n'.join(found or ()))

    def lines(self, case: Any, verbose: bool = True) -> list[str]:
        """The words of all functions that have something to say about a case; without `verbose`, of the answer and of checks."""
        return [found.words for found in self.asked(case, verbose).values() if found.words]

    def asked(self, case: Any, verbose: bool = False) -> dict[str, Finding]:
        """What the functions find, by name: all of them if `verbose`, else only the answer and those that may find a fault."""
        return {name: self.find(name, case) for name in self if verbose or name not in self.remarks or name == self.first}

    def told(self, case: Any, verbose: bool = False) -> list[str]:
        """The words of the answer and of the faults, or of all functions in a `verbose` report."""
        found = self.asked(case, verbose)
        first = [found.pop(self.first).words] if self.first else []
        return [*filter(None, first), *(one.words for one in found.values() if one.words and (verbose or one.fault))]
