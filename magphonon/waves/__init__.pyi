from .fields import (
    field_at as field_at,
    field_of as field_of,
    field_ridges as field_ridges,
)
from .ridge_tables import read_ridges as read_ridges
from .scan_tables import read_scan as read_scan, write_scan as write_scan
from .scans import Scan as Scan, sampled as sampled
from .spectrum import ridge as ridge, wavenumber_frequency as wavenumber_frequency
from .wave_analysis import branch as branch, compare as compare, scan_waves as scan_waves, waves as waves
from .wave_report import report as report
from .wave_source import (
    burst_setup as burst_setup,
    polarisations as polarisations,
    run_burst as run_burst,
    wavevector as wavevector,
)
