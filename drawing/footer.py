"""The bars below a picture: a legend, and notes."""

from collections.abc import Mapping

import numpy as np

from .camera_panel import TEXT_COLOUR
from .canvas import Colour, Picture, blank, draw_face, draw_text, fitting_height_px, text_width_px, wrap_text

BAR_COLOUR: Colour = (18, 15, 14)
TEXT_PX, LINE_PX, PAD_PX = 15.0, 24.0, 8.0


def draw_text_bar(notes: list[tuple[str, Colour]], width_px: int) -> Picture:
    """Draw texts below each other, each in its colour: (H, width_px, 3). Long texts are wrapped."""
    lines = [(line, colour) for text, colour in notes for line in wrap_text(text, TEXT_PX, width_px - 2 * PAD_PX)]
    bar = blank(width_px, round(len(lines) * LINE_PX + PAD_PX), BAR_COLOUR)
    for row, (line, colour) in enumerate(lines):
        draw_text(bar, line, PAD_PX, row * LINE_PX + TEXT_PX, TEXT_PX, colour)
    return bar


def draw_legend_bar(colours: Mapping[str, Colour], width_px: int) -> Picture:
    """Draw a legend: names with squares in their colours, in as many rows as needed: (H, width_px, 3)."""
    rows: list[list[tuple[float, str]]] = [[]]
    left = PAD_PX
    for name in colours:
        name_px = TEXT_PX + text_width_px(name, TEXT_PX) + 4 * PAD_PX
        if rows[-1] and left + name_px > width_px:
            rows.append([])
            left = PAD_PX
        rows[-1].append((left, name))
        left += name_px
    bar = blank(width_px, round(len(rows) * LINE_PX + PAD_PX), BAR_COLOUR)
    for row, names in enumerate(rows):
        for left, name in names:
            top, text_left = PAD_PX + row * LINE_PX, left + TEXT_PX + PAD_PX
            square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * TEXT_PX
            draw_face(bar, square + np.array([left, top]), colours[name])
            height_px = fitting_height_px(name, TEXT_PX, width_px - text_left - PAD_PX)
            draw_text(bar, name, text_left, top + TEXT_PX, height_px, TEXT_COLOUR)
    return bar
