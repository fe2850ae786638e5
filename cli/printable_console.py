"""A rich console for text from files: it prints escapes such as `\\x1b` instead of control characters."""

from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from ..runtime.printable import printable


class PrintableConsole(Console):
    """rich removes only few control characters, so a name in a file could send escape sequences to the terminal."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as rich does, and make the text printable. Styles are not part of the text."""
        for segment in super().render(renderable, options):
            is_text = segment.control is None
            yield segment._replace(text=printable(segment.text, keep="\n")) if is_text else segment
