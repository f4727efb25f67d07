"""Pictures of tutorials for sphinx-gallery: figures of matplotlib that a block leaves in its names, with or without pyplot."""

from weakref import WeakSet

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageOps
from sphinx_gallery import gen_rst
from sphinx_gallery.scrapers import figure_rst

SEEN = WeakSet()
WHITE = 250  # of 255, from which a pixel counts as white


def figures(block, block_vars, gallery_conf):
    """Save the figures that are new since the last block, and return the text that shows them."""
    paths = []
    for value in block_vars['example_globals'].values():
        first = value.flat[0] if isinstance(value, np.ndarray) and value.size else value   # of several axes
        figure = first if isinstance(first, Figure) else getattr(first, 'figure', None)
        if isinstance(figure, Figure) and figure not in SEEN:
            SEEN.add(figure)
            path = next(block_vars['image_path_iterator'])
            figure.savefig(path, dpi=160)
            paths.append(path)
    plt.close('all')
    return figure_rst(paths, gallery_conf['src_dir'])


def thumbnail(picture, out, width, height):
    """The first panel of a picture, as large as its frame; sphinx-gallery itself would set all of it into white."""
    drawn = trimmed(Image.open(picture).convert('RGB'))
    ink = np.array(drawn.convert('L')) < WHITE
    wide = first_panel(ink.T, ink.shape[0] * width // height)
    high = first_panel(ink, ink.shape[1] * height // width)
    shown = ImageOps.expand(trimmed(drawn.crop((0, 0, wide, high))), 8, 'white')
    ImageOps.pad(shown, (width, height), color='white').save(out)


def trimmed(picture):
    """Without its white margins."""
    return picture.crop(ImageOps.invert(picture.convert('L')).getbbox())


def first_panel(ink, most):
    """How many rows to show, at most so many: as far as the widest white gap of their second half, where a panel ends."""
    if len(ink) <= most:
        return len(ink)
    blank = np.flatnonzero(~ink[:most].any(axis=1))
    gaps = [gap for gap in np.split(blank, np.flatnonzero(np.diff(blank) > 1) + 1) if len(gap) and gap[-1] > most / 2]
    return max(gaps, key=len)[0] if gaps else most


gen_rst.scale_image = thumbnail
