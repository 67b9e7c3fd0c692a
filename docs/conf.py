"""The site: ``uv run --group docs sphinx-build -W -n docs out/site``. It is built, and read, without network."""

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "extensions"))

from simulator import __version__  # noqa: E402  the checkout's own

project, author, copyright = "Flatlight", "The Flatlight authors", "The Flatlight authors, Apache-2.0"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "site_flowchart",
    "site_links",
    "site_mathml",
    "site_sources",
]
exclude_patterns = ["images"]
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["mermaid"]
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # a page of the repository may begin with a heading of the second level

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "none"  # names have their units, docstrings shapes: types of arrays would only hide the arguments
autodoc_preserve_defaults = True
autoclass_content = "class"
napoleon_numpy_docstring = False
napoleon_attr_annotations = False
napoleon_use_ivar = True
napoleon_use_rtype = False
highlight_language = "none"  # what a terminal shows, unless a page says which language
default_role = "literal"  # docstrings quote code by single backticks

html_theme = "furo"
html_title = "Flatlight"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_math_renderer = "mathml"
pygments_style, pygments_dark_style = "friendly", "monokai"


def setup(app):
    """Keep Napoleon from taking what a property's docstring says before a colon for a type."""

    def part(app, what, name, thing, options, lines):
        if what == "property" and lines:
            lines[0] = lines[0].replace(": ", " – ")

    app.connect("autodoc-process-docstring", part, priority=400)
