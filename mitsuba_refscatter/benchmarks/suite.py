"""The scenes of ``refscatter compare --suite``: what the literature measures on, with bodies made by code."""

import io
from dataclasses import dataclass
from pathlib import Path

from .. import example_scenes as scene_files
from . import report, scaling
from .duel import Subject
from .methods import METHODS


@dataclass(frozen=True)
class Case:
    """A scene, the number of triangles of its body, and what is changed: ``density``, a factor of the medium's coefficients;
    ``light``, the position of the point light."""

    name: str
    scene: str
    triangles: int
    density: float = 1.0
    light: tuple = ()
    internal_bounces: int = 0
    methods: tuple = tuple(METHODS)

    def subject(self, directory, resolution):
        """The case as a ``Subject``; its files go to a directory."""
        import mitsuba as mi

        path, count = scene_files.write_scene(self.scene, Path(directory) / self.name, self.triangles)

        def load():
            scene = scene_files.load(path, res=str(resolution))
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
SMALL = 9680

SIZES = tuple(
    Case(f"{scene}_{triangles}", scene, triangles)
    for scene, triangles in (
        ("bumpy_sphere", SMALL), ("branches", 16301), ("bumpy_sphere", 50000), ("branches", 69451), ("bumpy_sphere", 310000),
        ("branches", 346000), ("branches", 500000), ("bumpy_sphere", 1000000),
    )
)  # fmt: skip
CASES = (
    *SIZES,
    *(Case(f"density_{scale}", "bumpy_sphere", SMALL, density=scale, methods=BEST) for scale in (2, 8, 32, 128)),
    Case("light_near", "bumpy_sphere", SMALL, light=(-1.1, 1.0, 0.4)),
    Case("light_behind", "bumpy_sphere", SMALL, light=(0.4, 0.6, -4.0)),
    Case("light_beside_the_camera", "bumpy_sphere", SMALL, light=(1.5, 1.0, 5.0)),
    *(Case(f"internal_reflections_{n}", "bumpy_sphere", SMALL, internal_bounces=n,
           methods=("refscatter", "holzschuch2015", "walter2009", "photon_beams", "straight_line")) for n in (0, 4)),
)  # fmt: skip


def summary(outcomes):
    """What stands at the head of the report: time to the quality of ours by case and method, and cost over triangles."""
    names = list(dict.fromkeys(row["method"] for outcome in outcomes for row in outcome.rows))
    lines = []
    for outcome in outcomes:
        rows = {row["method"]: row for row in outcome.rows}
        cells = [outcome.subject.name, f"{outcome.subject.triangles:,}", f"{outcome.rows[0]['relmse']:.1e}"]
        cells += [report.told_time(rows[name]) if name in rows else "" for name in names]
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    heads = ["scene", "triangles", f"relMSE of {names[0]}", *(name.replace("_", " ") for name in names)]
    table = f"<table><tr>{''.join(f'<th>{head}</th>' for head in heads)}</tr>{''.join(lines)}</table>"
    return f"<h2>Seconds to the quality of {names[0]}</h2>{table}<h2>Cost and triangles</h2><figure>{_plot(outcomes)}</figure>"


def _plot(outcomes):
    sized = {case.name for case in SIZES}
    rows = [row for outcome in outcomes if outcome.subject.name in sized for row in outcome.rows]
    if not rows:
        return ""
    buffer = io.BytesIO()
    scaling.plot(rows, buffer)
    return report.image_tag(buffer.getvalue())
