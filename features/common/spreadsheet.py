"""Text in the cells of CSV files, which spreadsheets take for formulas by its first character.

References
----------
https://owasp.org/www-community/attacks/CSV_Injection
"""

_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
_QUOTE = "'"


def guarded(text: str) -> str:
    """Return the text as a cell that a spreadsheet shows as it is, and `unguarded` gives back.

    Numbers stay as they are.
    """
    if not text.startswith((*_FORMULA, _QUOTE)) or _is_number(text):
        return text
    return _QUOTE + text


def unguarded(cell: str) -> str:
    """Return the text of a cell that `guarded`, or a person, wrote."""
    return (
        cell[1:] if cell.startswith(_QUOTE) and cell[1:].startswith((*_FORMULA, _QUOTE)) else cell
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text == text.strip()
