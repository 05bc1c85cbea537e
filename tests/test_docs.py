"""Links and references of the documentation; `make docs` builds it."""

import json
import re
from pathlib import Path

import pytest
import yaml

import symo_exp
from tests import pages
from tests.pages import ROOT

DOCS = ROOT / "docs"
PAGES = [*pages.PAGES, *DOCS.glob("*.ipynb")]


def named(page: Path) -> set[Path]:
    """The pages in the tables of contents of a page."""
    blocks = re.findall(r"```{toctree}\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.S)
    words = [line.rpartition("<")[2].rstrip(">") for b in blocks for line in b.splitlines()]
    return {
        found.resolve()
        for word in words
        if re.fullmatch(r"[\w./*]+", word)
        for found in page.parent.glob(f"{word}.*")
    }


def test_every_page_is_in_a_table_of_contents():
    start = DOCS / "index.md"
    contents, new = {start}, {start}
    while new:
        new = {p for page in new if page.suffix == ".md" for p in named(page)} - contents
        contents |= new
    written = [page for page in PAGES if page.parent == ROOT or page.is_relative_to(DOCS)]
    assert {*written, *(ROOT / "results").glob("**/README.md")} <= contents


def anchors(page: Path) -> set[str]:
    """The anchors of the headings of a page, as GitHub and the site form them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    found = set()
    for heading in re.findall(r"^#+ (.+)", text, flags=re.M):
        words = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)
        found.add(re.sub(r"[^\w -]", "", words.lower()).replace(" ", "-"))
    return found


@pytest.mark.parametrize("page", PAGES, ids=pages.relative)
def test_files_and_headings_that_a_page_links_to_exist(page):
    for link in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        linked = page.parent / name if name else page
        assert linked.exists(), link
        assert not anchor or anchor in anchors(linked), link


def test_what_code_of_a_page_imports_is_in_the_reference():
    texts = [page.read_text(encoding="utf-8") for page in DOCS.glob("*.md")]
    lines = [
        line
        for text in texts
        for code in pages.blocks(text, "python")
        for line in code.splitlines()
    ]
    imports = [re.fullmatch(r"from (symo_exp\S*) import (.*)", line) for line in lines]
    used = {f"{x[1]}.{name}" for x in imports if x for name in x[2].split(", ")}
    reference = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    assert used
    assert used - set(re.findall(r"^\.\. auto\w+:: (\S+)", reference, flags=re.M)) == set()


@pytest.mark.parametrize("page", PAGES, ids=pages.relative)
def test_formulas_have_only_forms_that_the_site_draws(page):
    """Docutils puts an index under an accented letter, and a power at the second bar of a norm."""
    text = page.read_text(encoding="utf-8")
    for formula in [*pages.blocks(text, "math"), *re.findall(r"\$([^$\n]+)\$", text)]:
        assert not re.search(r"\\(hat|bar|d?dot|tilde|vec)( \w|\{\w+\})\}?_", formula), formula
        assert not re.search(r"(?<!left)(?<!right)\\\|", formula), formula


def test_the_tutorial_is_kept_without_what_it_gives():
    cells = json.loads((DOCS / "tutorial.ipynb").read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)


def test_the_cited_version_is_this_one():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    (thesis,) = (one for one in cited["references"] if one["type"] == "thesis")
    assert cited["version"] == symo_exp.__version__
    assert f"## [{symo_exp.__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    for page in ("README.md", "docs/index.md", "docs/cite.md"):
        text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
        for told in ("Saul Santos", thesis["title"], str(thesis["year"])):
            assert told in text.replace("> ", ""), page
