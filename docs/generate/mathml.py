"""Formulas as MathML, by docutils: browsers draw it themselves, so that pages need no network."""

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml


def inline(writer, node):
    """For Sphinx's writer: a formula within a line."""
    writer.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def displayed(writer, node):
    """A formula of its own."""
    writer.body.append(writer.starttag(node, 'div', CLASS='math'))
    writer.body.append(tex2mathml(node.astext()).replace('<math ', '<math display="block" ', 1) + '</div>\n')
    raise nodes.SkipNode
