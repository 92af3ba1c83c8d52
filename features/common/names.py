"""Names of missions, annotators, files and classes, which systems write in several ways."""

import unicodedata


def is_utf8(text: str) -> bool:
    """Tell whether a text, such as a file's name of any bytes, can be written as UTF-8."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def same_text(text: str) -> str:
    """Return the text in Unicode's form NFC, so that one name is one text.

    Some systems write ``é`` as one character and others, such as macOS in names of files, as two.
    """
    return text if text.isascii() else unicodedata.normalize("NFC", text)
