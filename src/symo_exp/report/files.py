"""Writing a report: the tidy table, tables, figures, one Markdown file and one page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from symo_exp.files import write_frame, write_text
from symo_exp.report.document import Report
from symo_exp.report.runs import save_runs
from symo_exp.report.tables import latex, markdown_table

WRITTEN = ".written"
"""The file beside a report that lists its files."""


def write_report(report: Report, out: Path, *, formats: Sequence[str], page: bool) -> list[Path]:
    """Write the files of a report below ``out``, replacing those of an earlier one.

    Files of the earlier one that this report lacks are deleted; no other files are. Each file is
    replaced as a whole, so that it stays as it was where the disk is full.

    Args:
        report: The content to write.
        out: The folder, made if need be.
        formats: Of the figures: any of ``png``, ``pdf``, ``svg``.
        page: Whether ``index.html`` is written.

    Returns:
        The files written.
    """
    files = [save_runs(report.runs, out / f"runs.{suffix}") for suffix in ("csv", "parquet")]
    for name, table in report.extra.items():
        write_frame(out / name, table)
        files.append(out / name)
    texts = {"report.md": markdown_report(report, pictures="png" in formats)}
    for one in report.tables:
        texts |= {f"tables/{one.key}.md": markdown_table(one), f"tables/{one.key}.tex": latex(one)}
    if page:
        from symo_exp.report.page import html

        texts["index.html"] = html(report)
    for name, text in texts.items():
        write_text(out / name, text)
        files.append(out / name)
    if formats:
        from symo_exp.report.charts import draw_charts

        for figure in report.figures:
            files += draw_charts(figure, out / "figures", formats)
    _delete_former(out, [path.relative_to(out).as_posix() for path in files])
    return files


def _delete_former(out: Path, names: Sequence[str]) -> None:
    """Delete the files of the earlier report that are not among ``names``, which are listed."""
    listed = out / WRITTEN
    before = listed.read_text(encoding="utf-8").splitlines() if listed.exists() else []
    for name in set(before) - set(names):
        if (out / name).resolve().is_relative_to(out.resolve()):  # the list may have been edited
            (out / name).unlink(missing_ok=True)
    write_text(listed, "\n".join(names) + "\n")


def markdown_report(report: Report, *, pictures: bool) -> str:
    """Return the report as Markdown, with links to the PNG files if ``pictures``."""
    lines = [f"# {report.title}"]
    for section in report.sections:
        body = [*section.text, *map(markdown_table, section.tables)]
        for figure in section.figures if pictures else ():
            body += [f"![{figure.title}](figures/{figure.key}.png)", figure.caption]
        lines += [f"## {section.title}"] * bool(body and section.key != "answer") + body
    lines.append(report.summary)
    return "\n\n".join(lines) + "\n"
