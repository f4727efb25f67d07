"""Verdicts as lists of small functions, each of which finds one fact about a case and states it in words.

Examples
--------
>>> from magphonon.findings import Finding, Findings
>>> CHECKS = Findings()
>>> @CHECKS.check
... def balance(force):
...     return Finding(force, f'A force of {force} N is left.', fault=True) if force else Finding(force)
>>> @CHECKS.remark
... def size(force):
...     return Finding(1, 'One particle.')
>>> [judge(0.5).words for judge in CHECKS.values()], CHECKS.remarks
(['A force of 0.5 N is left.', 'One particle.'], {'size'})
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Finding:
    """What one function found.

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


Judge: TypeAlias = Callable[[Any], Finding]


class Findings(dict[str, Judge]):
    """The functions by name, in the order in which their words are printed."""

    def __init__(self) -> None:
        super().__init__()
        self.remarks: set[str] = set()  # names of those that are never a fault

    def check(self, judge: Judge) -> Judge:
        """Decorator that adds a function to the list, under its name."""
        self[judge.__name__] = judge  # pyright: ignore[reportAttributeAccessIssue]  functions have one
        return judge

    def remark(self, judge: Judge) -> Judge:
        """Decorator that adds a function whose finding is never a fault."""
        self.remarks.add(judge.__name__)  # pyright: ignore[reportAttributeAccessIssue]
        return self.check(judge)
