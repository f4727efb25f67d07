from .animation import animate as animate
from .axes import (
    legend_above as legend_above,
    letter_panels as letter_panels,
    new_axes as new_axes,
    new_figure as new_figure,
    panels as panels,
)
from .bands import plot_bands as plot_bands, plot_density as plot_density, plot_edge_bands as plot_edge_bands
from .fits import plot_band_fits as plot_band_fits, plot_fit as plot_fit
from .modes import plot_extents as plot_extents, plot_mode as plot_mode
from .response import (
    plot_band_ribbons as plot_band_ribbons,
    plot_response as plot_response,
    plot_transfer as plot_transfer,
)
from .structures import plot_lattice as plot_lattice, plot_patch as plot_patch
from .waves import plot_snapshot as plot_snapshot, plot_wave as plot_wave
from .zone import plot_zone as plot_zone
