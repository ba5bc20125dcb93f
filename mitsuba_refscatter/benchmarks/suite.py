"""The scenes of ``refscatter compare --suite``: what the literature measures on, with bodies made by code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi

from .. import example_scenes
from . import plotting, report, scaling
from .duel import Outcome, Subject
from .methods import METHODS


@dataclass(frozen=True)
class Case:
    """A scene made by code, and what is changed in it.

    name              of the case
    scene             one of ``example_scenes.SCENES``
    triangles         of its body, about
    density           factor of the medium's coefficients
    light             position of the point light (3,), world; empty: as the scene has it
    internal_bounces  internal reflections that are rendered
    methods           names of those that it is for
    """

    name: str
    scene: str
    triangles: int
    density: float = 1.0
    light: tuple[float, ...] = ()
    internal_bounces: int = 0
    methods: tuple[str, ...] = tuple(METHODS)

    def subject(self, directory: str | Path, resolution: int) -> Subject:
        """The case as a ``Subject`` of so many pixels on a side; its files go to a directory."""
        path, count = example_scenes.write_scene(self.scene, Path(directory) / self.name, self.triangles)

        def load():
            scene = example_scenes.load(path, res=str(resolution))
            parameters = mi.traverse(scene)
            if self.density != 1:
                for key, value in parameters:
                    if key.endswith("_medium.scale"):
                        parameters[key] = value * self.density
            if self.light:
                key = next(key for key, _ in parameters if key.endswith(".position"))
                parameters[key] = mi.Point3f(*self.light)
            parameters.update()
            return scene

        return Subject(self.name, load, count)


BEST = ("refscatter", "photon_beams", "straight_line")
WITH_REFLECTIONS = ("refscatter", "holzschuch2015", "walter2009", "photon_beams", "straight_line")
SMALL = 9680
"""Triangles where their number is not what is measured."""

SIZES = tuple(
    Case(f"{scene}_{triangles}", scene, triangles)
    for scene, triangles in (
        ("bumpy_sphere", SMALL),
        ("branches", 16301),
        ("bumpy_sphere", 50000),
        ("branches", 69451),
        ("bumpy_sphere", 310000),
        ("branches", 346000),
        ("branches", 500000),
        ("bumpy_sphere", 1000000),
    )
)
"""Of growing meshes."""

CASES = (
    *SIZES,
    *(Case(f"density_{scale}", "bumpy_sphere", SMALL, density=scale, methods=BEST) for scale in (2, 8, 32, 128)),
    Case("light_near", "bumpy_sphere", SMALL, light=(-1.1, 1.0, 0.4)),
    Case("light_behind", "bumpy_sphere", SMALL, light=(0.4, 0.6, -4.0)),
    Case("light_beside_the_camera", "bumpy_sphere", SMALL, light=(1.5, 1.0, 5.0)),
    *(
        Case(f"internal_reflections_{n}", "bumpy_sphere", SMALL, internal_bounces=n, methods=WITH_REFLECTIONS)
        for n in (0, 4)
    ),
)


def summary(outcomes: list[Outcome]) -> str:
    """HTML at the head of the report: time to the quality of the first method by case, and cost over triangles."""
    names = list(dict.fromkeys(row["method"] for outcome in outcomes for row in outcome.rows))
    cells = []
    for outcome in outcomes:
        rows = {row["method"]: row for row in outcome.rows}
        of_case = [outcome.subject.name, f"{outcome.subject.triangles:,}", f"{outcome.rows[0]['relmse']:.1e}"]
        cells.append(of_case + [report.told_time(rows[name]) if name in rows else "" for name in names])
    heads = ["scene", "triangles", f"relMSE of {names[0]}", *(name.replace("_", " ") for name in names)]
    return (
        f"<h2>Seconds to the quality of {names[0]}</h2>{report.table(heads, cells)}"
        f"<h2>Cost and triangles</h2><figure>{_plot(outcomes)}</figure>"
    )


def _plot(outcomes):
    """HTML of the plot of cost over triangles, empty where none of its cases has been measured."""
    sized = {case.name for case in SIZES}
    rows = [row for outcome in outcomes if outcome.subject.name in sized for row in outcome.rows]
    return report.image_tag(plotting.png_of(scaling.figure(rows), plotting.DPI)) if rows else ""
