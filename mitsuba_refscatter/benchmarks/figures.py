"""The figure of the method: a light path L -> P -> V, and the curve g = 0 on a body. By formulas in NumPy, no render.

``python -m mitsuba_refscatter.benchmarks.figures FILE.png``
"""

import sys

import numpy as np

from .. import example_scenes

ETA = 1.5
LIGHT = np.array([-2.6, 2.4, -0.9])
CAMERA, TARGET = np.array([0, 1.1, 5.2]), np.array([-0.15, 0.1, 0.3])
"""Of the scene ``bumpy_sphere``, and where the camera ray goes."""

FINE, COARSE = 81920, 1280
"""Triangles on which g is evaluated, and those that are drawn."""

SECTION_LIGHT, SECTION_P = np.array([-1.1, 2.1]), -0.25
SECTION_SEGMENT = np.array([[-1.6, -1.25], [1.7, -0.75]])
"""Of the left panel: where the light is, the abscissa of P, and the ends of the camera segment."""

BEAM = 0.18
"""Half of the width of the light beam there."""

OFF = 1e-4
"""How far from the boundary the ray starts that looks for the end of the camera segment."""

BLUE, ORANGE, GREY = "#1f5fa8", "#d9730d", "#777777"


def unit(v):
    """Vectors (..., k) of length 1."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def refract(d, n, eta):
    """Unit directions ``d`` behind a boundary, by Snell's law. ``n``: unit normals against d; ``eta``: index behind
    over that before.

    >>> refract(np.array([0.6, -0.8]), np.array([0.0, 1.0]), 1.5).round(3).tolist()  # sines: 0.6 = 1.5 x 0.4
    [0.4, -0.917]
    """
    cosine = -(d * n).sum(axis=-1, keepdims=True)
    return d / eta + n * (cosine / eta - np.sqrt(1 - (1 - cosine**2) / eta**2))


def hit(o, d, corners):
    """First of the triangles (F, 3, 3) that a ray meets, the barycentric coordinates (3,) there, and the distance."""
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(d, e2)
    inverse, q = 1 / (e1 * p).sum(axis=1), np.cross(o - a, e1)
    u, v, t = ((o - a) * p).sum(axis=1) * inverse, (q @ d) * inverse, (e2 * q).sum(axis=1) * inverse
    t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    k = int(np.argmin(t))
    return k, np.array([1 - u[k] - v[k], u[k], v[k]]), t[k]


def section(axes):
    """The left panel: the quantities of the formula in a plane."""

    def height(x):
        return 0.16 * np.sin(2.1 * x + 0.5)

    def at(x):
        """A point of the boundary, and the direction in which light goes on from there."""
        P, slope = np.array([x, height(x)]), 0.16 * 2.1 * np.cos(2.1 * x + 0.5)
        return P, refract(unit(P - SECTION_LIGHT), unit(np.array([-slope, 1.0])), ETA)

    (o, end), x = SECTION_SEGMENT, np.linspace(-1.9, 1.9, 200)
    d = unit(end - o)

    def meet(P, omega):
        """Where light from P meets the camera segment."""
        t, s = np.linalg.solve(np.stack([d, -omega], axis=1), P - o)
        return P + s * omega

    axes.fill_between(x, height(x), -1.7, color="#fdf1dc")
    axes.plot(x, height(x), color="black", lw=1.5)
    (a, from_a), (b, from_b), (P, omega) = (at(SECTION_P + shift) for shift in (-BEAM, BEAM, 0))
    beam = [SECTION_LIGHT, a, a + 2 * (meet(a, from_a) - a), b + 2 * (meet(b, from_b) - b), b]
    axes.fill(*np.transpose(beam), color=ORANGE, alpha=0.18, lw=0)
    V = meet(P, omega)
    axes.plot(*np.transpose([SECTION_LIGHT, P, V]), color=ORANGE, lw=2)
    axes.annotate("", end, o, arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 2})
    for point, name, place in ((SECTION_LIGHT, "L", (8, 4)), (P, "P", (10, 4)), (V, "V", (6, -16)), (o, "o", (-4, 9))):
        axes.plot(*point, "o", color="black", ms=5)
        axes.annotate(name, point, place, textcoords="offset points", fontsize=14, fontweight="bold")
    for middle, name, place, color in (
        (0.5 * (SECTION_LIGHT + P), "$d_L$", (7, 4), ORANGE), (0.5 * (P + V), r"$s,\ \omega$", (8, 2), ORANGE),
        (0.5 * (o + V), "$t,\\ d$", (-2, -18), BLUE),
    ):  # fmt: skip
        axes.annotate(name, middle, place, textcoords="offset points", fontsize=13, color=color)
    for text, point, color in (
        ("light beam", (-0.62, 0.55), ORANGE), ("boundary", (0.85, 0.17), "black"),
        ("camera segment", (0.5, -1.15), BLUE), ("a region that scatters", (0.4, -1.6), GREY),
    ):  # fmt: skip
        axes.annotate(text, point, color=color, fontsize=11, ha="right" if text == "light beam" else "left")
    axes.set(xlim=(-1.9, 1.9), ylim=(-1.7, 2.4), aspect="equal", title="A light path L → P → V")
    axes.axis("off")


def camera_segment(P, faces, n):
    """Start, unit direction and length of the camera segment in a body."""
    d = unit(TARGET - CAMERA)
    k, share, t = hit(CAMERA, d, P[faces])
    o, d = CAMERA + t * d, refract(d, unit(share @ n[faces[k]]), ETA)
    return o, d, hit(o + OFF * d, d, P[faces])[2] + OFF


def zeros(g, faces, *values):
    """Values at the ends of the zeros of g on triangles: (N, 2, k) for each of ``values`` (V, k). All are linear in
    between.

    >>> corners = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]])
    >>> zeros(np.array([1.0, -1.0, -3.0]), np.array([[0, 1, 2]]), corners)[0].tolist()
    [[[2.0, 0.0], [0.0, 1.0]]]
    """
    up = g[faces] > 0
    faces, up = (x[up.any(axis=1) & ~up.all(axis=1)] for x in (faces, up))
    lone = np.argmax(up == (up.sum(axis=1, keepdims=True) == 1), axis=1)  # the corner with a sign of its own
    a, b, c = (np.take_along_axis(faces, (lone[:, None] + k) % 3, axis=1)[:, 0] for k in range(3))
    shares = [g[a] / (g[a] - g[x]) for x in (b, c)]
    return [
        np.stack([(y[a].T + share * (y[x] - y[a]).T).T for x, share in zip((b, c), shares)], axis=1) for y in values
    ]


def curve(figure, axes):
    """The right panel: the zeros of g on the body, seen from the light; where they light the segment, by t."""
    from matplotlib.collections import LineCollection

    across = unit(np.cross(-LIGHT, [0, 1, 0]))
    view = np.stack([across, unit(np.cross(across, -LIGHT))])

    def facing(count):
        """Vertices, faces that face the light, all faces, and normals."""
        P, faces, n = example_scenes.make_body("bumpy_sphere", count)
        a, b, c = (P[faces[:, k]] for k in range(3))
        return P, faces[(np.cross(b - a, c - a) * (LIGHT - a)).sum(axis=1) > 0], faces, n

    P, drawn, _, _ = facing(COARSE)
    axes.triplot(*(view @ P.T), drawn, color="#d8d8d8", lw=0.5)
    P, faces, every, n = facing(FINE)
    o, d, length = camera_segment(P, every, n)
    omega = refract(unit(P - LIGHT), n, ETA)
    across_d = np.cross(d, omega)
    g = ((P - o) * across_d).sum(axis=1)
    t, s = ((np.cross(P - o, x) * across_d).sum(axis=1) / (across_d**2).sum(axis=1) for x in (omega, d))
    lines, t, s = zeros(g, faces, P @ view.T, t[:, None], s[:, None])
    t, s = t.mean(axis=(1, 2)), s.mean(axis=(1, 2))
    reached = (t > 0) & (t < length) & (s > 0)
    axes.add_collection(LineCollection(lines[~reached], colors=GREY, lw=1, linestyles="dotted"))
    found = axes.add_collection(LineCollection(lines[reached], array=t[reached], cmap="plasma", lw=3, capstyle="round"))
    figure.colorbar(found, ax=axes, shrink=0.7, label="t, where on the camera segment the light arrives")
    axes.plot(
        *(view @ np.transpose([o, o + length * d])), color=BLUE, lw=2, label="the camera segment, inside the body"
    )
    axes.legend(loc="lower left", frameon=False, fontsize=10)
    axes.set(aspect="equal", title="The curve g = 0 on the boundary, seen from the light")
    axes.axis("off")


def main(path):
    """Writes the figure."""
    from .report import pyplot

    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5.2), width_ratios=(1, 1.15), layout="constrained")
    section(left)
    curve(figure, right)
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main(sys.argv[1])
