"""Thresholds of boundaries: reading meshes, tessellating shapes, coarser meshes, silhouettes.

All are names of ``tolerances``.
"""

# Reading a mesh

VERTEX_NORMAL = 1e-6
"""Length of a vertex normal below which it has no direction."""

NO_VOLUME = 1e-9
"""Volume of a closed part, relative to the cube of its box's longest side, below which it encloses nothing."""

FLUSH = 1e-4
"""Share of its distance from the middle by which a corner is moved inwards before it is asked what encloses it."""

ENCLOSED_CORNERS = 64
"""Corners of a mesh, up to twice as many, that are asked whether another one encloses them."""

AT_CORNER = 1e-6
"""Distance of a light from a mesh's corner, relative to the mesh's size, below which it lies on it.

float32 rounds to 6e-8 of that size."""

AT_EDGE = 1e-10
"""1 + the cosine of the angle under which a light sees an edge, below which it lies on the edge: 1.4e-5 rad from pi."""

AT_FACE = 1e-4
"""Solid angle that a triangle lacks to half the sphere, in sr, below which a light lies on the triangle."""

CONVEX = 1e-6
"""Height of a corner over the plane of a neighbouring facet, relative to the mesh's size, that is rounding.

float32 is good to 6e-8."""

# Tessellating spheres, cylinders and disks

TESSELLATION_SHARE = 1 / 3
"""Part of the image's tolerated error that replacing curved surfaces by triangles may cause."""

TESSELLATION_ERROR = 2.0
"""Relative error of the image per square of the triangles' edges, these in radii of the sphere. Measured: 0.3 to 0.8,
up to 2.4 for slender ellipsoids lit along their axes, 0.2 for tubes. It is 5 where the light is seen through a ball
that scatters strongly forward (g = 0.9)."""

FREQUENCIES = 4, 128
"""Least and largest frequency of a geodesic sphere: of 320 and of 327680 triangles, whose error is 1e-4 or less."""

SEGMENTS = 16, 1024
"""Least and most segments of a circle: rounding to float32 tilts the triangles between the most by up to 1e-5 rad."""

TUBE_TRIANGLES = 20 * FREQUENCIES[1] ** 2
"""Most triangles of a tube: as many as of a sphere."""

TUBE_STRETCH = 4.0
"""Length of a tube's triangles relative to their width: nothing bends along the axis, but slivers are hard to cull."""

SURFACE_PLACE = 1e-3
"""Deviation, in radii, of Mitsuba's surface from that of ``to_world`` that is rounding and not another surface."""

SURFACE_ROUNDING = 4e-6
"""Deviation relative to the coordinates that is rounding in float32, several times over."""

SURFACE_NORMAL = 0.99
"""Least cosine between normals of Mitsuba's surface and of that of ``to_world`` that are the same but for the sign."""

FLATTENED = 1e-9
"""Determinant of a transform relative to the product of its columns' lengths below which it has no inverse."""

# Coarse meshes whose triangles are the first cells of light beams

COARSE_FEWEST = 1000
"""Triangles below which they are taken as they are."""

COARSE_WORTH = 0.2
"""Share of the triangles that a coarse mesh may have at most."""

COARSEST_TURN = 0.85
"""Turn of the normals (difference between the unit normals at the ends of an edge) in the coarse mesh: 50 degrees."""

COARSE_LONGEST = 0.125
"""Longest coarse edge relative to the body's size."""

BULGE = 1.0
"""How far from a coarse edge the boundary is looked for, relative to the edge times half the normals' turn along it.

Four times as far as a circle would be."""

SLIP = 1e-3
"""How far aside of where it slipped through the boundary a ray is sent, relative to the edge."""

COARSER = 0.5
"""By what power of two the turn of normals grows from one coarse mesh to the next."""

# Taking vertices away

ROUND_WORTH = 0.01
"""Vertices relative to faces that must go in a round for another one of the same length."""

LEAST_SHAPE = 0.25
"""Least height of a triangle relative to its longest edge."""

FIRST_SHAPE = 0.15
"""That height in the first round: otherwise nothing could be taken away from a regular mesh."""

LEAN = 0.7
"""Least cosine between a face and the normals at its corners."""

FLIP = 1e-3
"""By how much, in radians, the angles opposite to an edge must exceed pi together for it to be flipped.

Otherwise rounding would flip it back and forth."""

# Silhouettes

WIDEST_VIEW = 0.5
"""Smallest cosine to the view's axis for which the light's view is used: a field of 120 degrees."""

RASTER_CELLS = 8
"""Cells of the raster of a light's view on a side of a square that has a triangle's mean area."""

RASTER_LEVELS = 6, 11
"""Least and most levels of that raster, of 64 and of 2048 cells on a side: bounds its memory, 16 MiB."""

RASTER_STEPS = 4_000_000
"""Points at which edges are put on the raster, at most: bounds time and memory."""

RASTER_ROUNDING = 1e-6
"""By how much of its depth an edge is put nearer: float32 may round it away from the light."""

SILHOUETTE_SLACK = 1e-5
"""Share of an edge's distance from the light by which it may be beside a triangle and still counts as in front of it.

float32, several times over."""
