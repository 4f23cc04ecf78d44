"""Configuration of the documentation site; ``tools/build_docs.py`` stages the pages and starts the build."""

from __future__ import annotations

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

import tissueid

project = "TissueID"
author = "The TissueID maintainers"
version = release = tissueid.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
source_suffix = {".md": "markdown"}
exclude_patterns = ["docs/site"]
nitpicky = False

myst_heading_anchors = 6
myst_fence_as_directive = ["math"]
suppress_warnings = ["myst.header"]

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
napoleon_use_rtype = False
python_use_unqualified_type_names = True

html_theme = "alabaster"
html_theme_options = {
    "description": "Mechanics of living tissue. Research use only.",
    "fixed_sidebar": False,
    "page_width": "1160px",
    "sidebar_width": "260px",
    "font_family": "system-ui, sans-serif",
    "head_font_family": "system-ui, sans-serif",
}
html_sidebars = {"**": ["about.html", "searchfield.html", "navigation.html"]}
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"


def _visit_math(translator, node: nodes.Element) -> None:
    """Write an equation as MathML, which browsers draw without scripts or fonts from elsewhere."""
    block = isinstance(node, nodes.math_block)
    translator.body.append(tex2mathml(node.astext(), as_block=block))
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer of equations."""
    app.add_html_math_renderer("mathml", (_visit_math, None), (_visit_math, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
