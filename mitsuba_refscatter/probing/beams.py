"""The light beams of a scene's lights, for a look at them: where their cells are on the boundaries."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..core.cache import Cache
from ..culling.light_beams import LightBeams
from ..integrators.prepared import prepare
from ..light import beams, light_samples
from ..options import Options
from .records import LightCells


def light_beams(scene, tolerance: float = 0.01) -> list[LightCells]:
    """The light beams that ``refscatter`` makes of the lights of a ``mi.Scene`` that are one point or direction.

    tolerance  as of the integrator, above 0
    """
    with dr.suspend_grad():
        prepared = prepare(scene, Options(tolerance=float(tolerance), surfaces=False), Cache(), lambda: 0)
        out = []
        for emitter in prepared.scene.emitters:
            for body in [] if emitter.drawn else [x for region in prepared.scene.regions for x in region.boundaries]:
                _, culling = prepared.culled(body, light_samples.exact(emitter), emitter)
                if isinstance(culling, LightBeams):
                    out.append(_cells(culling, body, emitter.name))
    return out


def _cells(culling, body, light):
    """``LightCells`` of a ``culling.light_beams.LightBeams``."""
    index = dr.arange(mi.UInt32, dr.width(culling.records) // beams.BEAM)
    lines, beam = beams.Lines.gather(culling.records, index), beams.LightBeams.gather(culling.records, index)
    P = [beams.start(*x) + beam.centre for x in zip(beam.omega, beam.m, beam.e)]
    exists = lines.radius.numpy() >= 0
    nodes = np.stack([np.array(p).T for p in P], axis=1)[exists] + np.array(body.centre)
    flux = sum(np.array(x) for x in beam.phi[3:])[exists] / 6
    return LightCells(light, body.name, nodes, flux, culling.estimate)
