from .dataset import sweep as sweep
from .questions import observables as observables
