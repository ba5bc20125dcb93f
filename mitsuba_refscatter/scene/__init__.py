"""What a ``mi.Scene`` holds as plain records: bodies, regions, media and emitters; and what is refused.

Nothing else of the renderer reads it. Rays are traced against it elsewhere, too: by ``transport``, ``light``,
``missing`` and ``probing``.
"""

from ..core.arrays import NONE
from .boundaries import holds
from .camera import hole_refusal, region_of_camera, side_refusal
from .errors import SceneError, name_shape
from .reader import parameters, read, refuse_gradients
from .records import ONCE, Scene
from .support import REFUSED, refusal

__all__ = [
    "NONE", "ONCE", "REFUSED", "Scene", "SceneError", "holds", "hole_refusal", "name_shape", "parameters", "read",
    "refusal", "refuse_gradients", "region_of_camera", "side_refusal",
]  # fmt: skip
