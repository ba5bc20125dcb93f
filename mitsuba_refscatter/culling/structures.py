"""What is made of the triangles of boundaries once for all lights: packed triangles, their order, and trees."""

from __future__ import annotations

import mitsuba as mi

from ..core import arrays
from ..core.cache import RecordsKey, TreeKey
from ..geometry import bvh, triangle
from .clearance import Clearance


class Structures:
    """Structures over the triangles of the boundaries of a scene.

    scene     ``scene.Scene``
    cache     ``core.cache.Cache``
    accuracy  ``tolerances.Accuracy``
    """

    def __init__(self, scene, cache, accuracy):
        self.scene, self.cache, self.accuracy = scene, cache, accuracy

    def records(self, body):
        """The packed triangles of a boundary, and maybe others."""
        if body.stands_for is None:
            return self.scene.records
        key = self.records_key(body)
        return self.cache.once(lambda: triangle.Patches(arrays.array(mi.Float, body.packed())), key)

    def records_key(self, body):
        """What ``records`` are made from."""
        return self.scene.records_key if body.stands_for is None else RecordsKey((body.key,))

    def once(self, kind, make, body):
        """What ``make()`` makes of the triangles of a boundary, once.

        kind  its name
        make  called without arguments
        body  ``scene.boundaries.Body``
        """
        return self.cache.once(make, TreeKey(kind, self.records_key(body), body.first_record))

    def order(self, body):
        """Triangles (UInt32, numbers among the records) of a boundary in the order in which trees take them."""

        def make():
            order = bvh.median_order(body.corners.mean(axis=1)) + body.first_record
            return arrays.array(mi.UInt32, order)

        return self.once("order", make, body)

    def clearance(self, body):
        """``Clearance`` of the mesh of a boundary itself, which no coarser one stands for."""
        body = body.stands_for or body
        corners = body.corners - body.centre
        return self.once("clearance", lambda: Clearance(self.scene.records, body.first_record, corners), body)
