"""`python -m magphonon` is the command `magphonon`."""

import sys

from .cli import main

sys.exit(main())
