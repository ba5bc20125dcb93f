"""Thresholds of the cells that light beams are made of."""

INWARDS = 1e-3
"""Share of its way to the middle of a cell by which rays start inside of its edge: there is more than one facet."""

LOOSER = 4.0, 16.0
"""Errors of light beams for camera segments that hold little of their camera sample, relative to those for others."""

SHARES = 0.25, 0.03, 0.0
"""Least share of its camera sample that a segment holds for beams of the least error, and for those of ``LOOSER``."""

FEWER_CELLS = 0.8
"""Cells relative to the triangles that face the light above which these are taken as first cells."""

MOST_CELLS = 500_000
"""Cells of light that are looked at, at most: bounds their memory, 0.4 GiB. Then the error stays larger."""

ASTRAY = 2.0
"""Error of the image per distance of light lines from where they are, relative to the width of their beam."""

SCATTERED = 0.25
"""Share of errors of the flux density at single places that is left where they have either sign."""

NO_BETTER = 0.5
"""Error of a quarter of a cell relative to that of the cell from which on cutting does not help: it should be 1/8."""

MIXED = 0.25
"""Share of a cell's flux that is taken to be wrong where a shadow ends on it."""

RIM_CELL = 2.0**-4
"""Largest edge of a cell of light, relative to how far light goes, where a light sends nothing into some directions."""

LEAST_CELL = 2.0**-14
"""Longest edge of a cell of light, relative to how far light goes, below which it is not cut."""

LEFT_OF_ERROR = 0.5
"""Share of the allowed error that may be left in cells that are not cut: the quarters of others need the rest."""

LOCAL = 2.0
"""Largest error per area of a cell, relative to the tolerance times the mean flux per area: no part of the light is
far worse than the rest."""


# Behind chains of refractions and reflections

BLACK = 1e-30
"""Least share of light that is told from none: its optical depth is finite."""

MIRROR_OFFSET = 1e-4
"""Relative to a mirror's largest coordinate: how far before it rays start that ask what it reflects."""

NO_QUADRATIC = 0.3
"""Error of a cell from which on a quadratic tells no more than corners do, but costs more."""

CHAINS_FINEST = 1e-3
"""Tolerance of light behind chains where that of first refractions is 0, exact triangles."""

CHAIN_CELL = 2.0**-4
"""Largest edge of a cell of light, relative to its body, that is followed to other surfaces, which may be small."""

CHAIN_SURFACES = 12
"""Most surfaces that a chain meets."""

LOST = 0.01
"""Flux of a chain that is not followed, relative to what comes to first boundaries times the allowed error."""

WEAKEST = 0.3
"""Largest error of the light of a chain."""

CANCELS = 0.4
"""Share that is left of the errors of light behind chains: a camera segment meets many beams."""

FEWER_CHAIN_CELLS = 4.0
"""As ``FEWER_CELLS``, of light behind chains."""
