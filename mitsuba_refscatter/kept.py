"""What renders of the same meshes use again: everything that follows from a mesh alone."""

import drjit as dr
import mitsuba as mi


class Kept:
    """Things by what they were made from. Those that one round did not ask for are dropped at the end of the next."""

    def __init__(self):
        self._now, self._before = {}, {}

    def next_round(self):
        """Drops what the last round did not ask for."""
        self._now, self._before = {}, self._now

    def once(self, make, *key):
        """What ``make()`` made at the first use of ``key``."""
        if key not in self._now:
            self._now[key] = self._before[key] if key in self._before else make()
        return self._now[key]


def fingerprint(*arrays):
    """A tuple that tells arrays of numbers of 32 bits from others: 64 bits for each that is not empty."""
    out = []
    for x in arrays:
        if dr.width(x) == 0:
            continue
        bits = dr.reinterpret_array(mi.UInt32, x)
        for mixed in mi.sample_tea_32(bits, dr.arange(mi.UInt32, dr.width(bits)) + dr.opaque(mi.UInt32, len(out))):
            out.append(dr.sum(mi.UInt64(mixed)))
    dr.eval(out)
    return tuple(int(x[0]) for x in out)
