"""Names of missions, annotators, files and classes, which systems write in several ways."""

import unicodedata


def same_text(text: str) -> str:
    """Return the text in Unicode's form NFC, so that one name is one text.

    Some systems write ``é`` as one character and others, such as macOS in names of files, as two.
    """
    return text if text.isascii() else unicodedata.normalize("NFC", text)
