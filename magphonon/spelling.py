"""Suggestions for misspelt keys, kinds and commands: the entry of a list that was probably meant."""

from __future__ import annotations

from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any


def nearest(word: object, choices: Iterable[Any], likeness: float = 0.6) -> str | None:
    """The choice that was probably meant, or None: one that begins with `word` ('b_N_m_a' for 'b'), or a similar one.

    Parameters
    ----------
    word : object
    choices : iterable
    likeness : float
        Least ratio of `difflib.SequenceMatcher`, 0 to 1.
    """
    choices = [choice for choice in choices if isinstance(choice, str)]
    if not isinstance(word, str):
        return None
    begun = [choice for choice in choices if choice.lower().startswith(f'{word.lower()}_')]
    near = get_close_matches(word.lower(), [choice.lower() for choice in choices], 1, likeness)
    return begun[0] if begun else next((choice for choice in choices if choice.lower() in near), None)


def did_you_mean(word: object, choices: Iterable[Any], otherwise: str = '') -> str:
    """The end of a message: "; did you mean 'bands'?" or, if no choice is similar, "; " and `otherwise`."""
    near = nearest(word, choices)
    return f'; did you mean {near!r}?' if near else f'; {otherwise}' if otherwise else ''
