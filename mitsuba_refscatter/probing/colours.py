"""Colours that tell triangles apart."""

import colorsys

STEP = 0.6180339887
"""From one colour to the next, as a part of the circle: the golden section keeps neighbours apart."""

START = 0.55
"""Place of the first on the circle, from red: blue."""


def hue(i):
    """Place of colour number ``i`` on the circle, in [0, 1)."""
    return (START + i * STEP) % 1


def colour(place):
    """(r, g, b) in [0, 1] of a place on the circle."""
    return colorsys.hsv_to_rgb(place, 0.9, 0.75)


def colours(n):
    """``n`` colours as (r, g, b) in [0, 1]."""
    return [colour(hue(i)) for i in range(n)]
