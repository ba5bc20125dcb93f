"""Estimators: how single scattering is summed along camera segments."""

from .curve import Curve
from .interval import Interval
from .point import Point

ESTIMATORS = {"curve": Curve(), "interval": Interval(), "point": Point()}
"""Each ``protocol.Estimator`` by the name of the option."""
