"""How `make docs` builds the pages; everything it needs is on this machine."""

import re
from collections.abc import Sequence
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
napoleon_attr_annotations = False
autodoc_default_options = {"exclude-members": "model_config, unspoken_keys"}


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _drop_absent)
    app.connect("autodoc-process-docstring", _adapt, priority=400)  # before napoleon, which is at 500
    app.connect("autodoc-process-signature", _short_types)


def _drop_absent(app: Sphinx, name: str, source: list[str]) -> None:
    """Leave pages that are not written yet out of the menus."""
    if name == "index":
        here = Path(app.srcdir)
        source[0] = re.sub(r"^[a-z/-]+\n", lambda m: m[0] if _is_page(here, m[0].strip()) else "", source[0], flags=re.M)


def _is_page(folder: Path, name: str) -> bool:
    return name == "self" or (folder / f"{name}.md").exists()


def _adapt(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """What our docstrings have and napoleon does not know: results without a type, attributes described together."""
    _split_attributes(lines)
    _plain_returns(lines)


def _split_attributes(lines: list[str]) -> None:
    """Attributes that share a description get it each."""
    if "Attributes" not in lines:
        return
    row = lines.index("Attributes") + 2
    while row < len(lines) and not (row + 1 < len(lines) and lines[row + 1].startswith("---")):
        end = next((k for k in range(row + 1, len(lines)) if not lines[k].startswith(" ")), len(lines))
        names = lines[row].split(", ")
        if len(names) > 1:
            described = [line for name in names for line in (name, *lines[row + 1 : end])]
            lines[row:end] = described
            end = row + len(described)
        row = end


def _plain_returns(lines: list[str]) -> None:
    """A section Returns that holds text alone is text, not a type."""
    for row in range(len(lines) - 2):
        if lines[row] == "Returns" and set(lines[row + 1]) == {"-"} and lines[row + 2].startswith("    "):
            end = next((k for k in range(row + 2, len(lines)) if not lines[k].startswith("    ")), len(lines))
            lines[row:end] = ["", f":returns: {lines[row + 2].strip()}", *lines[row + 3 : end], ""]
            return


def _short_types(
    app: Sphinx, what: str, name: str, obj: object, options: object, signature: str | None, result: str | None
) -> tuple[str | None, ...]:
    """Types as the sources write them: FloatArray, not what numpy makes of it; limits stand on the page of settings."""
    return tuple(text and _short(text) for text in (signature, result))


def _short(text: str) -> str:
    # "~", which Sphinx hides, stands for a short name.
    array = r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?(?:numpy\.)?(\w+)\]\]"
    text = re.sub(array, _alias, text)
    return re.sub(r"Annotated\[(\w+), [^\]]*\]", r"\1", text)


def _alias(found: re.Match[str]) -> str:
    kinds: Sequence[tuple[str, str]] = (("float", "FloatArray"), ("bool", "BoolArray"), ("int", "IntArray"))
    return next((alias for kind, alias in kinds if found[1].startswith(kind)), "NDArray")
