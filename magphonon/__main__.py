"""`python -m magphonon` is the command `magphonon`."""

import sys

from .cli.main import main

sys.exit(main())
