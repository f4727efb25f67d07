"""The one way to ask atoms for their repulsion, and what it must answer."""


from .calculator import MagneticRepulsion, masses_of


def repulsion_of(atoms):
    """The MagneticRepulsion attached to `atoms`, whose masses are looked at too.

    Raises
    ------
    ValueError
        If there is none, or a mass is not a positive number.
    """
    if not isinstance(atoms.calc, MagneticRepulsion):
        raise ValueError(f'the atoms carry {atoms.calc!r} as calculator; '
                         'attach atoms.calc = MagneticRepulsion(atoms, potential, ...)')
    masses_of(atoms)
    return atoms.calc
