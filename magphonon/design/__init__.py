"""Sensitivities of frequencies to parameters, uncertainty, and the inverse design of a lattice for a wanted band."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
