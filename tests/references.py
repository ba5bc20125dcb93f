"""What ``volpath`` finds in the scenes of tests, kept: statistics of many renders, one file per scene in ``references/``.

``make references`` renders those that are missing or whose scene has changed; ``make test-all`` renders each anew, with other
seeds, and compares. So tests render our side alone, against references with less noise than they would have time for.
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
"""Whether references are rendered where they are missing (``pytest --make-references``)."""


def of(name, scene, render, size):
    """``Statistics`` of the renders that ``render()`` makes of a ``scene`` (whatever describes it: see ``fingerprint``), with
    blocks of size x size pixels; as they are kept under a ``name``."""
    path, mark = FOLDER / (re.sub(r"[^a-z0-9]+", "_", name.lower()) + ".npz"), fingerprint(scene)
    if path.exists():
        with np.load(path) as kept:
            if str(kept["fingerprint"]) == mark:
                return Statistics(**{key: kept[key] for key in kept.files if key != "fingerprint"})
    if not MAKE:
        pytest.fail(f"{path.name} is missing or of another scene: make references")
    found = Statistics.of(render(), size)
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(path, fingerprint=mark, **asdict(found))
    return found


def fingerprint(scene):
    """A hash of nested dictionaries of numbers, texts, arrays, transforms and bitmaps, that rounding errors don't change."""
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
