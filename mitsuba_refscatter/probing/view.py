"""A probe in space, as an HTML file that needs nothing else: body, camera ray, light paths, curve on the body."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .colours import colour, hue
from .records import Probe

PATHS = 24
"""Light paths that are shown."""

MOST_TRIANGLES = 50_000
"""Triangles of a body that are shown as they are; vertices of larger ones are joined in the cells of a grid."""

GRID = 96
"""Cells of that grid along the body's longest side."""

AROUND = 2.0
"""How far around the segment and the curve bodies are shown, relative to the diagonal of their box."""

OUTSIDE = 0.6
"""How far rays to camera and lights are drawn, relative to the diagonal of the box of what is shown of bodies."""

AT_LIGHT = 1e-3
"""How near to a light a path that is drawn so far ends at it, relative to that length."""


def write(probe: Probe, path: str | Path) -> None:
    """Write a probe as HTML: drag to rotate, roll to zoom, click in the legend to hide."""
    from plotly import graph_objects

    figure = graph_objects.Figure(layout=_layout(probe))
    low, high = _surroundings(probe)
    segment = probe.segments[probe.segment]
    ends = [segment.origin, segment.origin + segment.length * segment.direction]
    for boundary in probe.boundaries:
        near = ((boundary.corners.min(axis=1) <= high) & (boundary.corners.max(axis=1) >= low)).all(axis=1)
        if near.any():
            name = boundary.name if near.all() else f"{boundary.name}, near the segment"
            figure.add_trace(_mesh(graph_objects, boundary.corners[near], name))
            ends += [f(boundary.corners[near], axis=(0, 1)) for f in (np.min, np.max)]
    farthest = OUTSIDE * np.linalg.norm(np.ptp(np.clip(ends, low, high), axis=0))
    for line in (*_beams(probe), *_camera_ray(probe, farthest), *_light_paths(probe, farthest), *_curve(probe)):
        figure.add_trace(graph_objects.Scatter3d(**line))
    figure.write_html(path, include_plotlyjs=True, config={"displaylogo": False})


def _layout(probe):
    axis = {"showbackground": False, "showgrid": False, "zeroline": False, "showticklabels": False, "title": ""}
    title = f"pixel ({probe.pixel[0]}, {probe.pixel[1]}): light onto segment {probe.segment} of the camera ray"
    scene = {"aspectmode": "data", "camera": _eye(probe), **dict.fromkeys(("xaxis", "yaxis", "zaxis"), axis)}
    return {
        "title": title,
        "scene": scene,
        "margin": {"l": 0, "r": 0, "t": 50, "b": 0},
        "legend": {"x": 0.01, "y": 0.95},
    }


def _eye(probe):
    """Where it is first seen from: across the plane of segment and light, on the camera's side."""
    segment = probe.segments[probe.segment]
    middle, light = segment.origin + 0.5 * segment.length * segment.direction, probe.lights[0]
    across = np.cross(segment.direction, light.position if light.distant else light.position - middle)
    to_camera = probe.camera[0] - middle
    across, to_camera = (x / max(np.linalg.norm(x), 1e-30) for x in (across, to_camera))
    eye = (1 if across @ to_camera >= 0 else -1) * across + 0.7 * to_camera
    return {"eye": dict(zip("xyz", eye)), "up": dict(zip("xyz", (0, 1, 0)))}


def _surroundings(probe):
    """The box (low, high) in which bodies are shown."""
    segment = probe.segments[probe.segment]
    ends = [segment.origin + share * segment.length * segment.direction for share in (0, 1)]
    points = np.concatenate([ends, probe.curve.position.reshape(-1, 3)])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = AROUND * np.linalg.norm(high - low)
    return low - margin, high + margin


def _mesh(graph_objects, corners, name):
    vertices, faces = _joined(corners)
    return graph_objects.Mesh3d(
        **dict(zip("xyz", vertices.T)), **dict(zip("ijk", faces.T)), color="#9db4c8", opacity=0.2, hoverinfo="skip",
        name=name, showlegend=True, flatshading=False,
    )  # fmt: skip


def _joined(corners):
    """Vertices (V, 3) and faces (F, 3) of triangles; simplified where there are too many."""
    low, side = corners.min(axis=(0, 1)), np.ptp(corners, axis=(0, 1)).max()
    cells = GRID if len(corners) > MOST_TRIANGLES else 1 << 20
    points = corners.reshape(-1, 3)
    place = np.round((points - low) * (cells / max(side, 1e-30))).astype(np.int64)
    _, vertex, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    vertex = vertex.ravel()
    vertices = np.stack([np.bincount(vertex, x) for x in points.T], axis=1) / count[:, None]
    faces = vertex.reshape(-1, 3)
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return vertices.astype(np.float32), faces[whole].astype(np.int32)


def _polylines(lines):
    """Coordinates of lines (n, k, 3) as x, y, z with gaps in between."""
    lines = np.asarray(lines, dtype=np.float32)
    gap = np.full((len(lines), 1, 3), np.nan, dtype=np.float32)
    return dict(zip("xyz", np.concatenate([lines, gap], axis=1).reshape(-1, 3).T))


def _line(name, lines, colour, width):
    """Lines (n, k, 3) of one name, as plotly takes them."""
    style = {"color": colour, "width": width}
    return {**_polylines(lines), "mode": "lines", "name": name, "line": style, "hoverinfo": "name"}


def _beams(probe):
    """Outlines of the cells of light beams, hidden until they are asked for in the legend."""
    for cells in probe.beams:
        lines = cells.nodes[:, [0, 3, 1, 4, 2, 5, 0]]
        name = f"{len(lines)} light beams of {cells.light}"
        yield {**_line(name, lines, "#5b7fa6", 1), "visible": "legendonly"}


def _camera_ray(probe, farthest):
    """The camera ray: its segments, the probed one thick; and the way from the first surface to the camera.

    farthest  length of that which is drawn, at most
    """
    ways = [[s.origin, s.origin + s.length * s.direction] for s in probe.segments]
    yield _line(f"segment {probe.segment}, probed", [ways[probe.segment]], "#d62728", 8)
    others = [way for k, way in enumerate(ways) if k != probe.segment]
    if others:
        yield _line("its other segments", others, "#f2a3a3", 3)
    start, first = probe.camera
    length = np.linalg.norm(start - first)
    if length > 0:
        yield _line("to the camera", [[first, first + (start - first) * min(1, farthest / length)]], "#d62728", 3)


def _light_paths(probe, farthest):
    """Some light paths, evenly spread over the radiance that they bring.

    farthest  length outside of the body that is drawn, at most
    """
    curve, segment = probe.curve, probe.segments[probe.segment]
    order = np.argsort(curve.distance[:, 1], kind="stable")
    brought = np.cumsum(curve.integral.sum(axis=1)[order])
    if len(brought) == 0 or brought[-1] <= 0:
        return
    places = np.searchsorted(brought, (np.arange(PATHS) + 0.5) / PATHS * brought[-1])
    chosen = order[np.unique(places)]
    P = curve.position[chosen, 1]
    V = segment.origin + curve.distance[chosen, 1, None] * segment.direction
    where = np.array([light.position for light in probe.lights])[curve.light[chosen]]
    distant = np.array([light.distant for light in probe.lights])[curve.light[chosen], None]
    to_light = np.where(distant, farthest * where, where - P)
    to_light *= np.minimum(1, farthest / np.linalg.norm(to_light, axis=1, keepdims=True))
    yield _line(f"{len(chosen)} light paths", np.stack([P + to_light, P, V], axis=1), "#e8a200", 2)
    near = ~distant[:, 0] & (np.linalg.norm(P + to_light - where, axis=1) <= AT_LIGHT * farthest)
    if near.any():
        lights = np.unique(where[near], axis=0).astype(np.float32)
        yield {
            **dict(zip("xyz", lights.T)),
            "mode": "markers",
            "name": "light",
            "marker": {"color": "#e8a200", "size": 7},
        }


def _curve(probe):
    """The curve g = 0 on the boundaries, each triangle's part in its colour in the picture."""
    of, places = probe.triangles, np.linspace(0, 1, 49)
    each = np.repeat(of.of, 3)  # both ends of a cell, and the gap
    scale = [[x, "rgb({},{},{})".format(*(int(255 * c) for c in colour(x % 1)))] for x in places]
    line = {"color": hue(each), "colorscale": scale, "cmin": 0, "cmax": 1, "width": 7}
    facts = np.stack([of.triangle[each], of.x_min[each], of.x_max[each]], axis=1).astype(np.float32)
    told = "triangle %{customdata[0]:.0f}<br>x_min %{customdata[1]:.5g}<br>x_max %{customdata[2]:.5g}<extra></extra>"
    name = f"points that light it, on {len(of.triangle)} triangles"
    yield {
        **_polylines(probe.curve.position[:, ::2]),
        "mode": "lines",
        "name": name,
        "line": line,
        "customdata": facts,
        "hovertemplate": told,
    }
