"""Extract commands, Python code and files from the pages and the sources."""

from __future__ import annotations

import ast
import io
import json
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
FOLDERS = ("docs", "results", "recordings")
PAGES = sorted(
    [*ROOT.glob("*.md"), *(page for folder in FOLDERS for page in (ROOT / folder).rglob("*.md"))]
)
SOURCES = sorted(
    file
    for folder in ("src", "conf", "sweeps", "benchmarks", "examples", "results")
    for file in (ROOT / folder).rglob("*")
    if file.suffix in (".py", ".yaml", ".sh")
)
COMMAND = re.compile(
    r"(?:python3? (?:-m (?:symo_exp|benchmarks)\b|[\w/]+\.py\b)|symo-exp |make [a-z]|pip install |"
    r"\.ci/run|[\w/]+\.sh\b|mlflow |sudo |\. \.venv)[^\n]*"
)
"""A command in running text."""


class Command(NamedTuple):
    """A shell command and the file that it stands in."""

    page: str
    line: str

    def __str__(self) -> str:
        return f"{self.page}: {self.line}"


def relative(path: Path) -> str:
    """Return the path from the root of the repository."""
    return path.relative_to(ROOT).as_posix()


def blocks(text: str, language: str) -> list[str]:
    """Return the fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.S | re.M)


def shell(block: str) -> Iterator[str]:
    """Yield the commands of a block, continued lines joined and comments removed."""
    for line in block.replace("\\\n", " ").splitlines():
        command = re.sub(r"(^|\s)# .*", "", line)
        if command.strip():
            yield " ".join(command.split())


def typed(page: Path) -> list[Command]:
    """Return the commands of a page, in blocks and in text."""
    text = page.read_text(encoding="utf-8")
    lines = [line for block in blocks(text, "sh") for line in shell(block)]
    prose = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    for span in re.findall(r"``(.+?)``|`([^`]+)`", prose):
        words = " ".join("".join(span).split())
        if COMMAND.fullmatch(words):
            lines.append(words)
    return [Command(relative(page), line) for line in dict.fromkeys(lines)]


def told(source: Path) -> list[Command]:
    """Return the commands in docstrings and comments of a source."""
    text = source.read_text(encoding="utf-8")
    if not COMMAND.search(" ".join(text.split())):  # most sources: parsing takes seconds
        return []
    if source.suffix == ".py":
        passages = [*_docstrings(text), *_comments(text)]
    else:
        passages = re.findall(r"(?:^|\s)# (.*)", text)
    found = []
    for passage in passages:
        spans = [" ".join(x.split()) for x in re.findall(r"`+([^`]+)`+", passage)]
        lines = [re.sub(r"\s\s+.*|\s# .*", "", line.strip()) for line in passage.splitlines()]
        found += [x for x in [*spans, *lines] if COMMAND.fullmatch(x)]
    return [Command(relative(source), line) for line in dict.fromkeys(found)]


def _docstrings(text: str) -> Iterator[str]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, kinds) and (words := ast.get_docstring(node)):
            yield words


def _comments(text: str) -> Iterator[str]:
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.string.lstrip("# ")


def files(page: Path) -> dict[str, str]:
    """Return the files that a page shows: a path alone in a line, then a block."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"^`([\w./]+)`\n\n```\w+\n(.*?)^```", text, flags=re.S | re.M)
    return dict(found)


def python(page: Path) -> str:
    """Return the Python code of a page or a notebook, without the files that it shows."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        return "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
    shown = set(files(page).values())
    return "\n".join(block for block in blocks(text, "python") if block not in shown)
