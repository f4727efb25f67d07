"""Pictures of tutorials for sphinx-gallery: figures of matplotlib that a block leaves in its names, with or without pyplot."""

from weakref import WeakSet

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageOps
from sphinx_gallery import gen_rst
from sphinx_gallery.scrapers import figure_rst

SEEN = WeakSet()


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
    drawn = Image.open(picture).convert('RGB')
    inked = drawn.crop(ImageOps.invert(drawn.convert('L')).getbbox())   # what is not white
    inked = ImageOps.expand(inked, drawn.width // 60, 'white')
    ImageOps.fit(inked, (width, height), centering=(0, 0)).save(out)


gen_rst.scale_image = thumbnail
