"""How Sphinx builds the site: `python -m sphinx -W docs docs/_build`, without a network.

`-t online` links to the pages of other projects; `-t all` runs the longer workflows for their pages, too.
"""

import sys
import tomllib
from html import escape
from pathlib import Path
from textwrap import shorten

from docutils import nodes
from jinja2.filters import do_striptags as strip_tags
from sphinx import addnodes

import magphonon

sys.path.insert(0, str(Path(__file__).parent))  # generate, which writes pages from the code
import generate
from generate import mathml

project = 'magphonon'
author = copyright = 'the magphonon developers'
version = release = magphonon.__version__

extensions = ['myst_parser', 'numpydoc', 'sphinx.ext.autodoc', 'sphinx.ext.intersphinx',
              'sphinx.ext.viewcode', 'sphinx_gallery.gen_gallery', 'matplotlib.sphinxext.plot_directive']
exclude_patterns = ['_build', 'tutorials/*.rst', 'gallery/**.rst', 'generate', 'reference/charts_found.md']
suppress_warnings = ['config.cache']  # functions in the settings of sphinx-gallery

myst_enable_extensions = ['dollarmath', 'amsmath', 'deflist', 'colon_fence']
myst_heading_anchors = 3

autodoc_typehints = 'none'   # numpydoc's Parameters say types and shapes
numpydoc_show_class_members = False
numpydoc_validation_checks = set()

intersphinx_mapping = {
    'numpy': ('https://numpy.org/doc/stable', None),
    'scipy': ('https://docs.scipy.org/doc/scipy', None),
    'ase': ('https://ase-lib.org', None),
    'phonopy': ('https://phonopy.github.io/phonopy', None),
} if tags.has('online') else {}  # noqa: F821  Sphinx gives the tags

NOTEBOOK = '''%matplotlib inline
# Figures of magphonon belong to no window: show each below the cell that drew it.
shown = []

def show(result):
    for name in ('figure', 'axes', 'ax'):
        drawn = globals().get(name)
        first = drawn.flat[0] if hasattr(drawn, 'flat') else drawn
        figure = getattr(first, 'figure', first)
        if figure is not None and figure not in shown:
            shown.append(figure)
            display(figure)

get_ipython().events.register('post_run_cell', show)'''
"""The first cell of every notebook."""

sphinx_gallery_conf = {
    'examples_dirs': ['tutorials', 'gallery'],
    'gallery_dirs': ['generated/tutorials', 'generated/gallery'],
    'filename_pattern': '.',
    'backreferences_dir': 'generated/backreferences',  # the page of a name shows the examples that use it
    'doc_module': ('magphonon',),
    'image_scrapers': ('generate.scraper.figures',),
    'within_subsection_order': 'FileNameSortKey',
    'abort_on_example_error': True,
    'download_all_examples': False,
    'first_notebook_cell': NOTEBOOK,
    'thumbnail_size': (400, 280),
    'capture_repr': (),   # what a block prints and draws, not the repr of its last line
    'show_signature': False,
    'write_computation_times': False,
    'min_reported_time': 1000,
}

plot_formats = ['svg']
plot_html_show_formats = plot_html_show_source_link = False
plot_include_source = False
plot_rcparams = {'svg.hashsalt': 'magphonon', 'font.size': 10}
plot_apply_rcparams = True

default_role = 'code'         # single backticks in docstrings

html_theme = 'furo'
html_math_renderer = 'mathml'
html_theme_options = {'top_of_page_buttons': []}   # the source of a page has no address yet
html_title = f'magphonon {release}'
html_static_path = ['_static']
html_css_files = ['gallery.css']
html_logo = html_favicon = '_static/logo.svg'
html_baseurl = tomllib.loads((Path(__file__).parents[1] / '.ci/owner.toml').read_text(encoding='utf-8'))['documentation']
html_extra_path = ['generated/explorers', 'waves.png']


DESCRIPTION = 'Bands, waves, responses and stability of lattices of particles that repel each other, on ASE and phonopy'


def described(doctree):
    """What a page says first, notes and formulas aside; or what the package is."""
    of_text = nodes.section, addnodes.desc_content
    said = (one.astext() for one in doctree.findall(nodes.paragraph)
            if isinstance(one.parent, of_text) and not one.next_node(nodes.math)) if doctree else ()
    return shorten(next(iter(said), DESCRIPTION), 200, placeholder=' ...')


def describe(app, page, template, context, doctree):
    """What a link to a page shows elsewhere: a description and, where the address of the site is known, a picture."""
    title = strip_tags(context.get('title') or 'magphonon')
    told = {'og:type': 'website', 'og:site_name': 'magphonon', 'og:title': title, 'og:description': described(doctree)}
    if address := app.config.html_baseurl.rstrip('/'):
        told |= {'og:image': f'{address}/waves.png', 'og:url': f'{address}/{page}.html'}
    tags = ''.join(f'<meta property="{name}" content="{escape(words)}">' for name, words in told.items())
    context['metatags'] = (f'{context.get("metatags") or ""}<meta name="description" content="{escape(told["og:description"])}">'
                           f'<meta name="twitter:card" content="summary_large_image">{tags}')


def setup(app):
    """Write the generated pages before Sphinx looks for sources, mend docstrings for its markup, draw formulas offline."""
    app.add_html_math_renderer('mathml', (mathml.inline, None), (mathml.displayed, None))
    app.connect('html-page-context', describe)
    app.connect('autodoc-process-docstring', generate.api.escape_docstring)
    app.connect('config-inited', lambda app, config: generate.write_all(Path(app.srcdir) / 'generated', app.tags.has('all')))
