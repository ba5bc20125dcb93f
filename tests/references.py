"""What tests compare with and takes long to compute, kept in ``references/``, one file each.

These are statistics of many renders by ``volpath``, and radiance by the float64 oracle and by quadrature.
``make references`` computes those that are missing or whose scene has changed. ``make test-all`` computes each anew
and compares (renders with other seeds). So ``make test`` has time for references of many rays and of little noise.

An array must follow from its scene in float64 alone. Rounding differs between processors, and moves radiance in
float64 by 1e-12 of the largest. A sensor's rays are float32 from Dr.Jit's compiled code: an ulp of theirs moves
radiance next to caustics by 4e-4. So such rays are kept as an array of their own, from which radiance is computed.
"""

import hashlib
import json
import re
from dataclasses import asdict, is_dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from comparison import Statistics

FOLDER = Path(__file__).parent / "references"
MAKE = False
"""Whether references are computed where they are missing (``pytest --make-references``)."""
ANEW = False
"""Whether arrays are computed to be compared with those that are kept (``pytest --references-anew``)."""


def of(name, scene, render, size):
    """``Statistics`` of the renders that ``render()`` makes of a ``scene``, as they are kept under a ``name``.

    ``scene`` is whatever describes it: see ``fingerprint``. Blocks have size x size pixels."""
    return Statistics(**_kept(name, scene, lambda: asdict(Statistics.of(render(), size))))


def array(name, scene, compute):
    """The array that ``compute()`` makes for a ``scene``, as it is kept."""
    found = _kept(name, scene, lambda: {"array": compute()})["array"]
    if ANEW:
        np.testing.assert_allclose(compute(), found, rtol=1e-5, atol=1e-6 * np.abs(found).max())
    return found


def _kept(name, scene, compute):
    path, mark = FOLDER / (re.sub(r"[^a-z0-9]+", "_", name.lower()) + ".npz"), fingerprint(scene)
    if path.exists():
        with np.load(path) as kept:
            if str(kept["fingerprint"]) == mark:
                return {key: kept[key] for key in kept.files if key != "fingerprint"}
    if not MAKE:
        pytest.fail(f"{path.name} is missing or of another scene: make references")
    found = compute()
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(path, fingerprint=mark, **found)
    return found


def fingerprint(scene):
    """A hash of nested dictionaries of numbers, texts, arrays, transforms and bitmaps.

    Rounding errors don't change it."""
    return hashlib.sha256(json.dumps(_plain(scene)).encode()).hexdigest()


def _plain(x):
    if isinstance(x, dict):
        return {key: _plain(value) for key, value in x.items()}
    if isinstance(x, (list, tuple)):
        return [_plain(value) for value in x]
    if isinstance(x, (str, bool, int)) or x is None:
        return x
    if is_dataclass(x):
        return _plain(vars(x))
    if isinstance(x, mi.ScalarTransform4f):
        x = x.matrix
    return [f"{value:.4g}" for value in np.array(x, dtype=np.float64).ravel()]
