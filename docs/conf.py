"""How Sphinx makes the site of these pages: `make site`. It loads nothing from outside and warns of orphans."""

from __future__ import annotations

import functools
import gc
import re
import sys
from pathlib import Path

import math_core
from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.search.en import SearchEnglish
from sphinx.transforms import SphinxTransform
from sphinx.util import logging

import navsim

gc.disable()  # pages stay to the end of the build: a third of its time would go to looking for garbage

HERE = Path(__file__).resolve().parent
CONTENTS = "contents/"
"""Where the contents pages are, whose lists of links are the tree of the site."""

project = "navsim"
author = "The navsim developers"
project_copyright = author
version = release = navsim.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinxcontrib.bibtex"]
exclude_patterns = ["_build"]
highlight_language = "none"  # a block without a language is a table or a command
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # forges typeset such a block, too
myst_heading_anchors = 4
nb_execution_mode = "force"  # pages with code cells alone are executed: those in notebooks/
nb_execution_raise_on_error = True
nb_execution_timeout = 600
autodoc_typehints = "none"  # docstrings have the types
napoleon_google_docstring = False
napoleon_use_ivar = True
default_role = "literal"  # of docstrings

bibtex_bibfiles = ["../navsim/report/sources.bib"]
bibtex_default_style = "unsrt"
suppress_warnings = ["bibtex.missing_field"]  # of some sources no more is known, and none is invented

html_theme = "pydata_sphinx_theme"
html_title = f"navsim {release}"
html_static_path = ["_static"]
html_css_files = ["navsim.css"]
html_search_scorer = str(HERE / "scorer.js")
html_show_sourcelink = False
html_copy_source = False
html_context = {"default_mode": "auto"}  # without it the theme complains in the console
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "show_version_warning_banner": False,
    "header_links_before_dropdown": 7,
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}


def link_reference(_: Sphinx, __: str, source: list[str]) -> None:
    """Lead links to the built pages of the reference, which a clone does not have.

    Sources link to a page that is in a clone, with the built page as the link's title.
    """
    source[0] = re.sub(r'\]\(((?:\.\./)*)keys-and-variables\.md "(reference/[^"]+)"\)', r"](\1\2)", source[0])


def add_tree(_: Sphinx, name: str, source: list[str]) -> None:
    """Give a contents page the tree that its links are: a page is listed once, readable on a forge."""
    if name.startswith((CONTENTS, "result-file")):
        pages = re.findall(r"^(?:-|\|(?:.*\|)?) \[[^\]]+\]\(([^)#]+)\.md\)", source[0], re.MULTILINE)
        source[0] += "\n\n```{toctree}\n:hidden:\n\n" + "\n".join(pages) + "\n```\n"


NOT_SEARCHED = ("changes", "bibliography")
"""Pages that name everything and explain nothing."""


def leave_out_of_search(app: Sphinx, _: nodes.document) -> None:
    """Mark such a page as Sphinx wants it."""
    if app.env.docname in NOT_SEARCHED:
        app.env.metadata[app.env.docname]["nosearch"] = "true"


class GlossaryIndex(SphinxTransform):
    """Put the words of the glossary into the index, which the site's search looks at first; each row has an anchor."""

    default_priority = 700  # before the domains collect index entries

    def apply(self, **_: object) -> None:
        """Add the entries to the first cells of the rows."""
        if self.env.docname != "glossary":
            return
        for body in self.document.findall(nodes.tbody):
            for row in body.findall(nodes.row):
                cell = row[0]
                terms = [term for term in re.split(r"[,;()]\s*", cell.astext()) if term.strip()]
                anchor = "term-" + nodes.make_id(terms[0])
                cell["ids"].append(anchor)
                entries = [("single", term.strip(), anchor, "main", None) for term in terms]
                cell.insert(0, addnodes.index(entries=entries))


class TypesetFormulas(SphinxTransform):
    """Replace LaTeX by MathML, which browsers typeset without a script. The search finds its letters, not commands."""

    default_priority = 700

    def apply(self, **_: object) -> None:
        """Typeset each formula; one that can't be read is a warning, and so an error of the build."""
        converter = math_core.LatexToMathML(fancy_error=False)
        for node in [*self.document.findall(lambda node: isinstance(node, (nodes.math, nodes.math_block)))]:
            block = isinstance(node, nodes.math_block)
            latex = node.astext()
            if block and r"\tag" in latex and r"\begin{align*}" not in latex:
                latex = rf"\begin{{equation}}{latex}\end{{equation}}"
            try:
                html = converter.convert_with_local_state(latex, displaystyle=block)
            except math_core.LatexError as error:
                logging.getLogger(__name__).warning("formula %s: %s", latex, error, location=node)
                continue
            if block:
                html = f'<div class="formula">{html}</div>'
            elif isinstance(after := node.next_node(descend=False, siblings=True), nodes.Text):
                stop = re.match(r"[.,;:)]*", after)[0]  # or a line could begin with it
                after.parent.replace(after, nodes.Text(after[len(stop) :]))
                html = f'<span class="formula">{html}{stop}</span>'
            node.replace_self(nodes.raw("", html, format="html"))


def setup(app: Sphinx) -> None:
    """What Sphinx calls first."""
    SearchEnglish.stem = functools.cache(SearchEnglish.stem)  # pages share most words: a tenth of a build
    app.connect("source-read", link_reference)
    app.connect("source-read", add_tree)
    app.connect("doctree-read", leave_out_of_search)
    app.add_transform(GlossaryIndex)
    app.add_transform(TypesetFormulas)


def write_reference() -> None:
    """The pages that schemas make, where these are the pages of navsim."""
    if (HERE / CONTENTS / "reference.md").is_file():
        sys.path.insert(0, str(HERE.parent / "scripts"))
        import reference

        reference.write()


write_reference()
