"""What a culling is: it finds the triangles of a boundary that may refract light onto camera segments."""

from __future__ import annotations

from abc import ABC, abstractmethod

from ..geometry import bvh


class Culling(ABC):
    """A tree over the triangles of a boundary, or over the light beams that they make, and its tests.

    A camera segment and an item of the tree are a pair (``pairs.Pairs``). Pairs that are found go to an estimator
    (``estimators.protocol``).

    tree         over the items, ``bvh.LEAF`` in each leaf
    width        mean width of the items, in units of the scene; 0 where segments never go through the tree in bundles
    """

    tree: bvh.Tree
    width: float

    for_one_light: bool
    """Whether it is made for one light sample, which camera samples then share. Else each segment may have its own.

    Such a culling knows the zeros of g before an estimator does, and proofs of visibility.
    """

    of_beams: type[Culling] | None = None
    """The same with light beams whose error follows the tolerance in place of triangles, or None."""

    bundle: int
    """Camera segments that go through the tree together, at most."""

    most_levels: int
    """Levels to which items are cut for single segments."""

    @classmethod
    @abstractmethod
    def of(cls, body, shadows, structures, drawn) -> Culling | None:
        """The culling of a boundary for a light sample; None if none of it is lit.

        body        ``scene.boundaries.Body``
        shadows     ``visibility.Shadows`` of the light sample
        structures  ``Structures`` of the scene
        drawn       number of light samples that share an image: then nothing is made for other renders; 0 for one alone
        """

    estimate = 0.0
    """Relative L1 error of the image that is expected of what it finds."""

    apart = 0.0
    """How far its light may start from the boundary, in units of the scene."""

    def by_share(self):
        """Cullings for segments by what they hold of their camera sample: list of (least share, ``Culling``)."""
        return [(0.0, self)]

    @abstractmethod
    def node_test(self, segments, incidence):
        """The conservative test against a node of the tree: a function for ``bvh.traverse``.

        segments   ``LocalSegments``, or ``Bundles`` of them
        incidence  ``optics.Incidence``, its light one or one for each segment
        """

    @abstractmethod
    def plausible(self, pairs, segment, incidence):
        """Which pairs (Bool) exist and may contribute, by a test of their own.

        pairs      ``pairs.Pairs``
        segment    ``LocalSegments`` of each pair
        incidence  ``optics.Incidence`` of each pair
        """

    def near(self, item, bundles):
        """Which items may contribute to a segment of bundles, lane by lane (Bool); only where ``bundle`` > 1.

        item     UInt32, indices
        bundles  ``Bundles``
        """
        raise NotImplementedError

    @abstractmethod
    def triangle_of(self, pairs, active=True):
        """Indices (UInt32) of the pairs' triangles among the scene's records."""

    @abstractmethod
    def take(self, pairs, incidence, active=True):
        """``pairs.Taken``: triangles, light beams and proofs for pairs.

        pairs      ``pairs.Pairs``
        incidence  ``optics.Incidence`` of each pair
        active     Bool, those that are asked for
        """
