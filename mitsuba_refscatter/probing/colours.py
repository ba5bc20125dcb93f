"""Colours that tell triangles apart."""

import colorsys

TURN = 0.6180339887
"""Of the colour circle, from one to the next: the golden section keeps any few apart."""


def colours(n):
    """``n`` colours as (r, g, b) in [0, 1]; neighbours differ."""
    return [colorsys.hsv_to_rgb((i * TURN) % 1, 0.85, (0.85, 0.6)[i % 2]) for i in range(n)]
