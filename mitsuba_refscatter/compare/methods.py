"""Our method and our versions of the published ones, as combinations of estimator and culling (departures: the heads of
``estimators`` and ``culling.spindle``), under the names that comparisons use."""

METHODS = {
    "refscatter": {},
    "holzschuch2015": {"estimator": "interval", "culling": "spindle", "samples": 1},
    "walter2009": {"estimator": "point", "culling": "spindle", "samples": 16},
}
"""Properties of the integrator; those left out are as the user, or the default, has them."""
