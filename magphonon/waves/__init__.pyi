from .branches import (
    Branch as Branch,
    Misfit as Misfit,
    branch as branch,
    compare as compare,
)
from .oblique import (
    oblique_waves as oblique_waves,
)
from .ridge_tables import (
    RidgePoints as RidgePoints,
    read_ridges as read_ridges,
    write_ridges as write_ridges,
)
from .rows import (
    Row as Row,
    row_of as row_of,
)
from .scan_tables import (
    read_places as read_places,
    read_scan as read_scan,
)
from .scans import (
    Scan as Scan,
)
from .spectrum import (
    Ridge as Ridge,
    Spectrum as Spectrum,
    ridge as ridge,
    wavenumber_frequency as wavenumber_frequency,
    without_drift as without_drift,
)
from .tone_burst import (
    Passage as Passage,
    send as send,
)
from .vibrometer import (
    Displacements as Displacements,
    measure as measure,
    read_displacements as read_displacements,
    write_displacements as write_displacements,
)
from .wave_analysis import (
    Wave as Wave,
    report as report,
    scan_waves as scan_waves,
    waves as waves,
)
from .wave_source import (
    Burst as Burst,
    Site as Site,
    polarisations as polarisations,
    site as site,
    wavevector as wavevector,
)
