"""The environment map of a photographer's studio: two softboxes before a dim backdrop."""

from __future__ import annotations

import numpy as np

STUDIO = "studio.pfm"
"""Its file name."""

WIDTH, HEIGHT = 64, 32
SOFTBOXES = (  # direction, cosine of half the angle, radiance
    ((-0.75, 0.6, 0.35), 0.955, (14.0, 12.5, 10.5)),
    ((0.85, 0.35, -0.45), 0.965, (5.0, 6.5, 9.0)),
)


def studio() -> bytes:
    """A PFM file: WIDTH x HEIGHT, latitudes and longitudes as Mitsuba's ``envmap`` has them (y up)."""
    v, u = np.meshgrid((np.arange(HEIGHT) + 0.5) / HEIGHT, (np.arange(WIDTH) + 0.5) / WIDTH, indexing="ij")
    theta, phi = np.pi * v, 2 * np.pi * u
    direction = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], axis=-1)
    radiance = np.multiply.outer(0.16 + 0.1 * direction[..., 1], [0.9, 1.0, 1.15])
    for towards, cosine, colour in SOFTBOXES:
        inside = direction @ (np.array(towards) / np.linalg.norm(towards)) > cosine
        radiance[inside] = colour
    # PFM stores rows from the bottom up; a negative scale means little endian.
    return f"PF\n{WIDTH} {HEIGHT}\n-1.0\n".encode("ascii") + radiance[::-1].astype("<f4").tobytes()
