"""What those who render may ask to be told, or changed, while they do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ..estimators.wavefront import Counts


@dataclass
class Hooks:
    """What goes into a render besides its scene and options, and what it tells besides its image.

    progress  (share done), called now and then, or None
    watch     (samples per pixel, image so far) -> how many are next (0: no more), or None; then the first pass is
              of one sample per pixel, and places in the pixels come from a sequence instead of the sampler
    accuracy  fields of ``tolerances.Accuracy`` by name, in place of those that the tolerance decides
    silent    whether no warnings of missing light are estimated: for measurements
    counts    the work of the last render
    """

    progress: Callable | None = None
    watch: Callable | None = None
    accuracy: dict = field(default_factory=dict)
    silent: bool = False
    counts: Counts = field(default_factory=Counts)


def takes_hooks(integrator) -> bool:
    """Whether an integrator (or None) takes ``Hooks``: those of this package do."""
    return type(integrator).__module__.startswith(__package__.partition(".")[0] + ".")
