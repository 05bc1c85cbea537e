"""The site: Sphinx reads the pages where they lie, so that links work here as on GitHub."""

from __future__ import annotations

import re
import sys
from importlib.metadata import version as installed
from pathlib import Path

from docutils import nodes
from docutils.utils.math import latex2mathml

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "docs"), str(ROOT)]

import architecture  # noqa: E402

project = "symo_exp"
author = "symo_exp contributors"
copyright = f"2026, {author}"
version = release = installed("symo_exp")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
root_doc = "docs/index"
include_patterns = [
    "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs/**", "results/README.md",
    "results/*/README.md", "results/*/report.md", "results/machines/simulated.md",
    "results/machines/rules.md", "recordings/*.md",
]  # fmt: skip
exclude_patterns = [".*", "build", "outputs", "mlruns", "multirun", "src", "tests", "docs/site"]

html_theme = "furo"
html_title = "symo_exp"
html_extra_path = ["site"]  # leads from the address of the site to its first page
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]  # as GitHub writes equations
myst_heading_anchors = 3

nb_execution_mode = "force"  # the tutorial is run whenever the site is built
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_output_stderr = "remove"  # bars of progress
nb_merge_streams = True

toc_object_entries_show_parents = "hide"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
maximum_signature_line_length = 80


def inline(self, node: nodes.math) -> None:
    self.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def block(self, node: nodes.math_block) -> None:
    self.body.append('<div class="math">')
    self.body.append(latex2mathml.tex2mathml(node.astext(), as_block=True))
    self.body.append("</div>")
    raise nodes.SkipNode


def numbers(app, doctree: nodes.document) -> None:
    """Cells of numbers are not broken at the hyphen of ``1e-4``."""
    for cell in doctree.findall(nodes.entry):
        if len(cell.astext()) < 40 and re.search(r"\de-\d", cell.astext()):
            cell["classes"].append("number")


def setup(app) -> None:
    """Equations as MathML, which browsers show by themselves; the picture of the packages."""
    app.connect("doctree-read", numbers)
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    architecture.draw(ROOT / "docs" / "drawn")
