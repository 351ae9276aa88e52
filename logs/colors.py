"""Colours that all pictures of a run share; told apart by colour-blind readers, too."""

from __future__ import annotations

AP_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#f0e442")
"""Okabe and Ito's palette for colour-blind readers without its black and its vermillion, which is
too close to the red of an outage (https://jfly.uni-koeln.de/color/)."""
OUTAGE_COLOR = "#d7191c"
HANDOVER_COLOR = "#e6e6e6"


def ap_color(index: int) -> tuple[float, float, float]:
    """Colour of the AP of that index, each part 0 … 1; from the seventh on a darker round."""
    shade = 0.65 ** (index // len(AP_COLORS))
    red, green, blue = rgb(AP_COLORS[index % len(AP_COLORS)])
    return red * shade, green * shade, blue * shade


def rgb(hexadecimal: str) -> tuple[float, float, float]:
    """(red, green, blue), each 0 … 1, of "#rrggbb"."""
    red, green, blue = (int(hexadecimal[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue
