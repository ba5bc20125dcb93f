"""What renders of one integrator use again, under keys that name all that it depends on.

A key is a frozen record, one class for each kind of thing. A function whose result is cached uses nothing of a scene or
of options that is not in the fields of its key. What depends on too much for that has the scene itself in its key, and
its parameters.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np


class Cache:
    """Things by what they were made from. Those that one round did not ask for are dropped at the end of the next."""

    def __init__(self):
        self._now, self._before = {}, {}

    def next_round(self):
        """Drops what the last round did not ask for."""
        self._now, self._before = {}, self._now

    def once(self, make, key):
        """What ``make()`` made at the first use of ``key``."""
        if key not in self._now:
            self._now[key] = self._before[key] if key in self._before else make()
        return self._now[key]


@dataclass(frozen=True)
class BodyKey:
    """Of a boundary's triangles and of how far its light is followed.

    kind     as ``Body.kind``
    eta      relative index of refraction
    has      which normals Mitsuba's mesh has, and whether it is flipped
    mesh     fingerprint of its buffers
    flipped  whether ``Body.flipped`` made the body
    visible_range  length to which ``Body.extended`` limits its light, in units of the scene; 0 where it does not
    """

    kind: str
    eta: float
    has: tuple[bool, ...]
    mesh: tuple[int, ...]
    flipped: bool = False
    visible_range: float = 0.0


@dataclass(frozen=True)
class RecordsKey:
    """Of packed triangles.

    bodies  whose they are, one after the other
    """

    bodies: tuple[BodyKey, ...]


@dataclass(frozen=True)
class TreeKey:
    """Of what is made of the triangles of one body.

    kind          what that is
    records       packed triangles of several bodies
    first_record  index of the body's first among them
    """

    kind: str
    records: RecordsKey
    first_record: int


def fingerprint(*arrays):
    """A tuple of int that tells Dr.Jit arrays of 32-bit numbers from others: 64 bits for each that is not empty."""
    out = []
    for x in arrays:
        if dr.width(x) == 0:
            continue
        bits = dr.reinterpret_array(mi.UInt32, x)
        for mixed in mi.sample_tea_32(bits, dr.arange(mi.UInt32, dr.width(bits)) + dr.opaque(mi.UInt32, len(out))):
            out.append(dr.sum(mi.UInt64(mixed)))
    dr.eval(out)
    return tuple(int(x[0]) for x in out)


def digest(*values):
    """Bytes that tell numbers, texts and arrays (NumPy's, Dr.Jit's) from others."""
    out = hashlib.blake2b(digest_size=16)
    for x in values:
        x = np.asarray(x)
        out.update(f"{x.dtype} {x.shape} ".encode())
        out.update(x.tobytes())
    return out.digest()
