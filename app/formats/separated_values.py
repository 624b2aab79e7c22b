"""Tables as spreadsheets write and read them: separators, decimal commas, cells like formulas.

RFC 4180 says comma; spreadsheets set up for a language with decimal commas put a semicolon, and
cells copied out of one come with tabs.
"""

import re

SEPARATORS = ",;\t"
DECIMAL_COMMA_SEPARATOR = ";"
"""Spreadsheets separate by it where the comma is taken by the decimals."""

_QUOTED = re.compile(r'"[^"]*"')
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+\s*")
# What spreadsheets begin to calculate at, and the apostrophe that keeps them from it (OWASP, CSV
# injection). Cells that had apostrophes before such a sign get one more, so that none is lost.
_FORMULA = re.compile(r"'*[=+\-@]")
_KEPT_TEXT = re.compile(r"'+[=+\-@]")


def separator_of(header: str) -> str:
    """Return what stands between the names of a header line: comma, semicolon or tab."""
    bare = _QUOTED.sub("", header.partition("\n")[0])
    # The first of the most frequent: a header of one column counts as comma-separated.
    return max(SEPARATORS, key=bare.count)


def decimal_text(cell: str, separator: str) -> str:
    """Return the cell of a number with its decimal comma, if any, as a point.

    Only where semicolons separate does a comma mean the decimals; elsewhere ``1,234`` may be
    either number, and nobody should be placed by a guess.

    Raises
    ------
    ValueError
        If the cell has a comma in a table that is not separated by semicolons.
    """
    if not _DECIMAL_COMMA.fullmatch(cell):
        return cell
    if separator != DECIMAL_COMMA_SEPARATOR:
        msg = f"{cell.strip()!r} is not a number: write a decimal point, or separate cells by ;"
        raise ValueError(msg)
    return cell.replace(",", ".")


def text_cell(text: str) -> str:
    """Return a text as a cell that no spreadsheet takes for a formula; `cell_text` undoes it."""
    return f"'{text}" if _FORMULA.match(text) else text


def cell_text(cell: str) -> str:
    """Return the text that `text_cell` made a cell of."""
    return cell[1:] if _KEPT_TEXT.match(cell) else cell
