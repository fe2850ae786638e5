"""Text and legend bars: their height and margins."""

from duospacenet.drawing.footer import draw_legend_bar, draw_text_bar

WHITE = (255, 255, 255)


def test_the_height_of_a_bar_grows_with_its_number_of_lines():
    one, three = draw_text_bar([("a", WHITE)], 300), draw_text_bar([("a", WHITE), ("b", WHITE), ("c", WHITE)], 300)
    assert one.shape[1] == three.shape[1] == 300
    assert three.shape[0] - one.shape[0] == 48


def test_bars_keep_a_margin_at_every_border():
    for bar in (
        draw_text_bar([("Wg" * 100, WHITE)], 200),
        draw_legend_bar({f"a name {i}": WHITE for i in range(9)} | {"W" * 60: WHITE}, 200),
    ):
        background = bar[0, 0]
        for border in (bar[:, :2], bar[:, -2:], bar[:2], bar[-2:]):
            assert (border == background).all()
