"""Culling: which triangles may refract light onto which camera segment."""

from .beams import Beams
from .spindle import Spindle

CULLINGS = {"beams": Beams, "spindle": Spindle}
"""Each ``protocol.Culling`` by the name of the option."""
