"""
A map over two parameters
=========================

The map shows the shear frequency at M as a function of the exponent of the law and the height of the pillars. The
force between neighbours is kept the same.
"""

import numpy as np

from magphonon import read_scene, sweep
from magphonon.plotting import plot_sweep

scene = read_scene('prototype')
over = {'law.a': np.linspace(3, 6, 13), 'foundation.pillar.height_m': np.linspace(0.1, 0.3, 11), 'law.force_N': [0.2369]}
answers = sweep(scene, over, 'bands.M.1', workers=1)
ax = plot_sweep(answers, 'bands.M.1')
ax.figure.savefig('sweep.png')
