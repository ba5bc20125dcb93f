"""The options of the integrator, each once: name, type, default, meaning."""

from dataclasses import dataclass, field, fields

from .core.spelling import advice
from .culling import CULLINGS
from .estimators import ESTIMATORS


class OptionError(ValueError):
    """A property with a value or type that the integrator does not take."""


@dataclass(frozen=True)
class Common:
    """Properties of all integrators of the package."""

    tolerance: float = field(
        default=0.01, metadata={"range": (0, 1), "meaning": "relative error of the image aimed at"}
    )
    internal_bounces: int = field(
        default=4, metadata={"range": (0, 64), "meaning": "internal reflections of the camera ray"}
    )
    light_samples: int = field(
        default=16,
        metadata={
            "range": (1, 1 << 16),
            "meaning": "light points per pass for emitters that are no point or direction",
        },
    )
    surfaces: bool = field(
        default=True, metadata={"meaning": "also show what is seen by reflection and through bodies"}
    )
    max_depth: int = field(
        default=-1,
        metadata={"range": (-1, 1 << 30), "meaning": "edges of the longest path between surfaces; -1: any number"},
    )
    aovs: str = field(default="", metadata={"meaning": "extra channels, comma-separated names of AOVS"})


@dataclass(frozen=True)
class Options(Common):
    """Properties of ``<integrator type="refscatter">``."""

    estimator: str = field(
        default="curve",
        metadata={"choices": ESTIMATORS, "meaning": "how light is summed along a segment"},
    )
    culling: str = field(
        default="beams", metadata={"choices": CULLINGS, "meaning": "how triangles are found for a segment"}
    )
    light_bounces: int = field(
        default=0,
        metadata={"range": (0, 64), "meaning": "refractions and reflections of light besides a first refraction"},
    )
    samples: int = field(
        default=0,
        metadata={
            "range": (0, 1 << 20),
            "meaning": "samples per interval (interval) or camera segment (point); 0: by the tolerance",
        },
    )


@dataclass(frozen=True)
class PhotonOptions(Common):
    """Properties of ``<integrator type="refscatter_photons">``."""

    mode: str = field(
        default="points", metadata={"choices": ("points", "beams"), "meaning": "what is stored of photons"}
    )
    photons: int = field(default=50000, metadata={"range": (1, 1 << 26), "meaning": "photons per pass"})
    radius: float = field(
        default=0.0,
        metadata={"range": (0, 1e30), "meaning": "around points and beams; 0: a hundredth of a body's size"},
    )
    alpha: float = field(default=1.0, metadata={"range": (0, 1), "meaning": "how the radius shrinks from pass to pass"})


AOVS = {
    "single_scatter": ("single_scatter.R", "single_scatter.G", "single_scatter.B"),
    "surfaces": ("surfaces.R", "surfaces.G", "surfaces.B"),
    "candidates": ("candidates",),
    "contributions": ("contributions",),
    "unresolved": ("unresolved",),
}
"""Extra outputs and their channels."""


def read(props, kind=Options):
    """Reads options of a ``kind`` from ``mi.Properties``; raises ``OptionError`` for an unknown name, a wrong
    type or value.

    >>> props = mi.Properties("refscatter")
    >>> props["tolerance"] = 0.1
    >>> read(props).tolerance, read(props).estimator
    (0.1, 'curve')
    >>> props["estimator"] = "curv"
    >>> read(props)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    mitsuba_refscatter.options.OptionError: refscatter: property "estimator" is 'curv': did you mean curve? ...
    """
    plugin, values = props.plugin_name(), {}
    for option in fields(kind):
        if option.name not in props:
            continue
        value, expected = props[option.name], type(option.default)
        if expected is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if type(value) is not expected:
            raise OptionError(
                f'{plugin}: property "{option.name}" has the value {value!r}: it must be of type {_KINDS[expected]}'
            )
        choices, bounds = option.metadata.get("choices"), option.metadata.get("range")
        if choices and value not in choices:
            raise OptionError(f'{plugin}: property "{option.name}" is {value!r}: {advice(value, choices)}')
        if bounds and not bounds[0] <= value <= bounds[1]:
            raise OptionError(
                f'{plugin}: property "{option.name}" is {value}: it must lie in [{bounds[0]}, {bounds[1]}]'
            )
        values[option.name] = value
    for name in props.unqueried():
        if props.type(name) != props.Type.Object:
            known = [option.name for option in fields(kind)]
            raise OptionError(f'{plugin}: there is no property "{name}": {advice(name, known)}')
    options = kind(**values)
    if isinstance(options, Options) and options.samples and ESTIMATORS[options.estimator].samples_field is None:
        raise OptionError(
            f'refscatter: property "samples" has no meaning for the estimator {options.estimator}: remove it'
        )
    for name in aov_list(options):
        if name not in AOVS:
            raise OptionError(f'{plugin}: property "aovs" names {name!r}: {advice(name, AOVS)}')
    return options


_KINDS = {float: "float", int: "integer", str: "string", bool: "boolean"}


def aov_list(options):
    """Names in the property ``aovs``.

    >>> aov_list(Options(aovs="surfaces, candidates"))
    ['surfaces', 'candidates']
    """
    return [name.strip() for name in options.aovs.split(",") if name.strip()]
