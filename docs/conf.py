"""How `make docs` builds the pages; everything it needs is on this machine."""

import re
from pathlib import Path

from sphinx.application import Sphinx

from survey_sim import __version__

project = "survey-sim"
author = "The survey-sim developers"
copyright = f"{author}; BSD-3-Clause"
release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["made/*.png"]
html_theme = "furo"
html_title = f"survey-sim {release}"
html_show_sourcelink = False
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_ivar = True


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _drop_absent)


def _drop_absent(app: Sphinx, name: str, source: list[str]) -> None:
    """Leave pages that are not written yet out of the menus."""
    if name == "index":
        here = Path(app.srcdir)
        source[0] = re.sub(r"^[a-z/-]+\n", lambda m: m[0] if _is_page(here, m[0].strip()) else "", source[0], flags=re.M)


def _is_page(folder: Path, name: str) -> bool:
    return name == "self" or (folder / f"{name}.md").exists()
