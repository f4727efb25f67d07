"""What is wanted from a lattice, as tables of a scene file, in SI."""

from pydantic import Field

from .tables import AtLeastTwo, Counts, Table, Text


class BandPlan(Table):
    """What the bands are computed along, and phonopy's supercell."""

    path: Text = Field(description="the special points in order, such as 'GMKG'")
    points: AtLeastTwo = Field(description='the number of wavevectors along the path')
    supercell: Counts = Field(description="phonopy's supercell, one number for each periodic direction")
