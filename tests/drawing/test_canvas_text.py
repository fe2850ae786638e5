"""Text wrapping."""

from duospacenet.drawing.canvas import text_width_px, wrap_text


def test_no_wrapped_line_is_too_wide_and_no_word_is_lost():
    text = "expected a camera above the road; got " + "x" * 300 + " and more"
    lines = wrap_text(text, 15, 400)
    assert all(text_width_px(line, 15) <= 400 for line in lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert wrap_text("two words", 15, 400) == ["two words"]
