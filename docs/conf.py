"""Settings of the site, for Sphinx; `docs/build_site.py` writes the folder of sources and starts
Sphinx.
"""

from __future__ import annotations

import re
from typing import Any

import flexgen

project = "flexgen"
author = "flexgen contributors"
copyright = author
release = version = flexgen.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
root_doc = "index"
exclude_patterns: list[str] = []

html_theme = "furo"
html_title = f"flexgen {release}"
html_copy_source = False
html_show_sphinx = False
html_last_updated_fmt = None

myst_heading_anchors = 4
highlight_language = "none"
default_role = "literal"  # `name` in a docstring is a name of Python

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings state types with shapes and units
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_rtype = False
# Types in docstrings are words ("name, path, RobotModel or Equations"), not all of them classes.
nitpick_ignore_regex = [("py:.*", ".*")]


def files_are_pathlib(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Parameters of the type Path are files: without the module they would lead to
    `flexgen.Path`.
    """
    lines[:] = [
        re.sub(r"^(\s*[\w, ]+ : .*(?:str|name)(?: or|,) )Path\b", r"\1pathlib.Path", line)
        for line in lines
    ]


def setup(app: Any) -> None:
    """Called by Sphinx; the docstrings are changed before napoleon reads them."""
    app.connect("autodoc-process-docstring", files_are_pathlib, priority=400)
