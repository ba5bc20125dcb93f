"""Homogeneous media and their phase functions."""

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import optics
from .errors import SceneError
from .support import MEDIUM, refusal


def check(name, medium):
    """Refuses a medium (of the object ``name``) that is not homogeneous or has values that no medium has."""
    if medium.class_name() != MEDIUM:
        raise refusal("medium", name, medium=medium.class_name())
    limits = {"albedo": (0, 1), "sigma_t": (0, np.inf), "scale": (0, np.inf), "phase_function": (-1, 1)}
    for key, value in mi.traverse(medium):
        option = key.split(".")[0]
        varies = key.endswith(".data") if option == "phase_function" else key.endswith(".data") or "grid" in key
        if option == "phase_function" and varies:
            voxels = np.array(value).reshape(-1, np.shape(value)[-1])
            varies = bool((voxels != voxels[0]).any())
        if option in ("albedo", "sigma_t", "phase_function") and varies:
            raise refusal("varies", name, what=option)
        # In spectral variants a colour is stored as coefficients of a spectrum; Mitsuba takes colours in [0, 1] there.
        colour = mi.is_spectral and isinstance(value, mi.Color3f)
        checked = (
            key == "scale" or key.endswith(".g") or (option != "phase_function" and key.endswith((".value", ".values")))
        )
        if option in limits and not colour and checked:
            low, high = limits[option]
            x = np.array(dr.ravel(value) if dr.is_array_v(value) else value, dtype=float)
            bad = x.ravel()[~(np.isfinite(x) & (x >= low) & (x <= high)).ravel()]
            if len(bad):
                what = "its phase function's g" if option == "phase_function" else f"its medium's {option}"
                allowed = f"in [{low}, {high}]" if np.isfinite(high) else "not negative"
                allowed = "in (-1, 1)" if low < 0 else allowed
                raise SceneError(f"{name} has {bad[0]:g} as {what}: it must be finite and {allowed}")


def visible():
    """Some wavelengths in nm for questions that are asked once per scene; empty but in spectral variants."""
    kind = type(dr.zeros(mi.Ray3f).wavelengths)
    return kind(450.0, 520.0, 580.0, 640.0) if mi.is_spectral else kind()


def scatters(medium):
    """Whether any light is scattered: not if the albedo is 0."""
    albedo = [value for key, value in mi.traverse(medium) if key.startswith("albedo.")]
    return not albedo or any(bool(dr.any(dr.ravel(value) != 0)) for value in albedo)


def coefficients(medium, wavelengths, d=None):
    """Scattering coefficient and extinction (sigma_s, sigma_t) in 1/length for rays of some wavelengths; along d, where
    these depend on it (``directed``)."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wavelengths = wavelengths
    if d is not None:
        mei.wi = -d
    sigma_s, _, sigma_t = medium.get_scattering_coefficients(mei, True)
    return sigma_s, sigma_t


def directed(medium):
    """None, or for media of microflakes, whose extinction depends on direction: ``f(omega, d)``, the extinction along
    omega relative to that along d."""
    function = medium.phase_function()
    if not mi.has_flag(function.flags(), mi.PhaseFunctionFlags.Microflake):
        return None

    def area(omega):
        mei = dr.zeros(mi.MediumInteraction3f)
        mei.wi = -omega
        return function.projected_area(mei)

    return lambda omega, d: area(omega) / area(d)


def phase(medium):
    """The phase function in 1/sr as a function of omega, the direction in which light travels, and d, that of the
    camera ray: a closed form, or Mitsuba's evaluation."""
    function = medium.phase_function()
    if function.class_name() == "IsotropicPhaseFunction":
        return lambda omega, d: optics.isotropic()
    if function.class_name() == "HGPhaseFunction":
        g = dr.opaque(mi.Float, float(dr.ravel(mi.traverse(function)["g"])[0]))
        return lambda omega, d: optics.henyey_greenstein(-dr.dot(omega, d), g)

    def evaluate(omega, d):
        mei = dr.zeros(mi.MediumInteraction3f)
        mei.wi = -d
        mei.sh_frame = mi.Frame3f(mei.wi)
        return function.eval_pdf(mi.PhaseFunctionContext(None), mei, -omega)[0]

    return evaluate
