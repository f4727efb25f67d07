"""Print the lower bounds that pyproject.toml declares as constraints for pip: of "scipy>=1.15", scipy==1.15."""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / 'pyproject.toml').read_text(encoding='utf-8'))['project']
extras = project['optional-dependencies']
requirements = project['dependencies'] + [requirement for extra in sys.argv[1:] for requirement in extras[extra]]
for requirement in requirements:
    if requirement.startswith('magphonon['):  # an extra of other extras
        continue
    name, bound = re.fullmatch(r'([\w-]+)(?:\[\w+\])?>=([\d.]+).*', requirement).groups()  # fails where no bound is declared
    print(f'{name}=={bound}')
