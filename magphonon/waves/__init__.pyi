from .fields import (
    Field as Field,
    field_at as field_at,
    field_map as field_map,
    field_of as field_of,
    field_ridges as field_ridges,
)
from .ridge_tables import (
    RidgePoints as RidgePoints,
    read_ridges as read_ridges,
    write_points as write_points,
    write_ridges as write_ridges,
)
from .scan_tables import read_places as read_places, read_scan as read_scan, write_scan as write_scan
from .scans import Scan as Scan
from .spectrum import Spectrum as Spectrum, ridge as ridge, wavenumber_frequency as wavenumber_frequency
from .thermal import ThermalBands as ThermalBands, thermal_bands as thermal_bands
from .vibrometer import sampled as sampled
from .wave_analysis import Branch as Branch, branch as branch, compare as compare, scan_waves as scan_waves, waves as waves
from .wave_report import report as report
from .wave_source import (
    Burst as Burst,
    burst_setup as burst_setup,
    polarisations as polarisations,
    run_burst as run_burst,
    wavevector as wavevector,
)
