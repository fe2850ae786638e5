"""Printable text: names and messages from files, made safe for a terminal."""

import unicodedata

# Embeddings, overrides and isolates reorder the characters around them, so that a text reads as another one.
_BIDIRECTIONAL_CONTROLS = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
_CONTROL_CATEGORIES = frozenset({"Cc", "Cs", "Zl", "Zp"})  # controls, surrogates, line and paragraph separators


def printable(text: str, keep: str = "") -> str:
    r"""Return a text in which each character that is not printable is an escape such as `\x1b` or `\u202e`.

    Escape sequences in a file name or a class name could otherwise change the terminal or hide a part of the text.
    keep: characters that stay, for example a line end.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode() for c in text)


def shortened(value: object, length: int = 60) -> str:
    """Return the `repr` of a value, which is printable, cut to at most `length` characters."""
    text = repr(value)
    return text if len(text) <= length else text[: length - 3] + "..."


def has_control_character(text: str) -> bool:
    """Return whether a text has a control character, a line separator, a bidirectional control or a lone surrogate."""
    return any(not character.isprintable() and _is_control(character) for character in text)


def _is_control(character: str) -> bool:
    return character in _BIDIRECTIONAL_CONTROLS or unicodedata.category(character) in _CONTROL_CATEGORIES
