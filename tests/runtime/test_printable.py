import pytest

from duospacenet.runtime.printable import has_control_character, printable, shortened


@pytest.mark.parametrize("text", ["", "CAM FRONT", "größe/前/🚗.png", "[red]a[/red] \\x1b", "٠١٢"])
def test_printable_text_stays(text):
    assert printable(text) == text
    assert not has_control_character(text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("\x1b[31mred\x1b[0m", "\\x1b[31mred\\x1b[0m"),
        ("\x9b2J", "\\x9b2J"),  # an escape sequence of one byte
        ("a\x07\x08\x7f\0", "a\\x07\\x08\\x7f\\x00"),
        ("line\nline\r", "line\\nline\\r"),
        ("gnp.\u202ecat", "gnp.\\u202ecat"),
        ("a\u2066b\u2029", "a\\u2066b\\u2029"),
        ("\ud800", "\\ud800"),
    ],
)
def test_control_characters_become_escapes(text, expected):
    assert printable(text) == expected
    assert has_control_character(text)
    assert printable(expected) == expected


def test_characters_that_join_letters_are_escaped_but_are_no_control_characters():
    name = "می\u200cخواهم"
    assert printable(name) == "می\\u200cخواهم"
    assert not has_control_character(name)


def test_line_ends_can_be_kept():
    assert printable("a\nb\x1b", keep="\n") == "a\nb\\x1b"


def test_shortened_values_are_printable_and_short():
    assert shortened("\x1b") == "'\\x1b'"
    assert shortened("x" * 100) == "'" + "x" * 56 + "..."
    assert len(shortened(list(range(1000)))) == 60
