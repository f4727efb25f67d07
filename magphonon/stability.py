"""The verdict on a structure before it runs."""

from .buckling import foundation_needed

__all__ = ['foundation_needed']
