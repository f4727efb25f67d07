"""
A tensegrity prism
==================

The scene `prism` lists three struts and nine cables.  With j = 6 joints, b = 12 members and s = 1 state of self-stress,
the rule of Calladine (1978) gives 3 j - 6 - b + s = 1 mechanism, so with D0 alone seven modes cost no energy.  Self-stress
stiffens the mechanism, and only the six rigid motions of the whole body remain.
"""

from magphonon import modes, read_scene
from magphonon.plotting import legend_above, new_figure

prism = read_scene('prism').atoms()
bonds, tensions = prism.calc.bonds, prism.calc.law.dphi(prism.calc.bonds.lengths)
figure = new_figure(7.0, 2.8)
drawn, ax = figure.add_subplot(121, projection='3d'), figure.add_subplot(122)
for i, j, t in zip(bonds.i, bonds.j, tensions, strict=True):
    drawn.plot(*prism.positions[[i, j]].T, color='C0' if t > 0 else 'C1', linewidth=1 if t > 0 else 4)
drawn.set_axis_off()
for model, mark, name in (('complete', 'o', '$D^0 + D^{*}$'), ('conventional', 'x', '$D^0$ alone')):
    prism.calc = prism.calc.about(prism, model=model)
    ax.plot(abs(modes(prism).frequencies_Hz), mark, label=name)
ax.set(xlabel='mode', ylabel='frequency (Hz)')
legend_above(ax)
figure.savefig('prism.png')
