"""What is made of the triangles of boundaries once for all lights: packed triangles, their order, and trees."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ..core import arrays
from ..core.cache import BodyKey, RecordsKey, TreeKey
from ..geometry import bvh
from ..tolerances import Accuracy
from .clearance import Clearance


@dataclass(frozen=True)
class BeamsKey:
    """Of the light beams of one light point in a body.

    kind          name of the class of culling
    body          the body
    records       its packed triangles, among others
    first_record  index of its first triangle there
    geometry      ``Scene.geometry``, for shadows
    distant       as ``optics.LocalLight`` has it
    L             three numbers, the same; the light lies on no shape
    tests_lit     whether rays test what is lit
    accuracy      what the option ``tolerance`` selects
    """

    kind: str
    body: BodyKey
    records: RecordsKey
    first_record: int
    geometry: tuple
    distant: bool
    L: tuple[float, ...]
    tests_lit: bool
    accuracy: Accuracy


class Structures:
    """Structures over the triangles of the boundaries of a scene.

    scene     ``scene.Scene``
    cache     ``core.cache.Cache``
    accuracy  ``tolerances.Accuracy``

    ``fewer_facets``: a set, of which bodies facets are fewer than other cells of light, and at which error.
    """

    def __init__(self, scene, cache, accuracy):
        self.scene, self.cache, self.accuracy = scene, cache, accuracy
        self.fewer_facets = set()

    def once(self, kind, make, body):
        """What ``make()`` makes of the triangles of a boundary, once.

        kind  its name
        make  called without arguments
        body  ``scene.boundaries.Body``
        """
        return self.cache.once(make, TreeKey(kind, self.scene.records_key, body.first_record))

    def beams(self, kind, make, body, shadows):
        """The light beams that ``make()`` makes of a light point in a boundary, once. ``kind``: class of culling;
        ``shadows``: ``visibility.Shadows`` of the light."""
        light, scene = shadows.light, self.scene
        key = BeamsKey(
            kind=kind.__name__, body=body.key, records=scene.records_key, first_record=body.first_record,
            geometry=scene.geometry, distant=light.distant, L=tuple(np.array(light.L).ravel().tolist()),
            tests_lit=shadows.lit is not None, accuracy=self.accuracy,
        )  # fmt: skip
        return self.cache.once(make, key)

    def order(self, body):
        """Triangles (UInt32, numbers among the records) of a boundary in the order in which trees take them."""

        def make():
            order = bvh.median_order(body.corners.mean(axis=1)) + body.first_record
            return arrays.array(mi.UInt32, order)

        return self.once("order", make, body)

    def clearance(self, body):
        """``Clearance`` of a boundary."""
        corners = body.corners - body.centre
        return self.once("clearance", lambda: Clearance(self.scene.records, body.first_record, corners), body)
