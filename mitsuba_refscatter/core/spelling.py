"""What to say about a name that is not known."""

from __future__ import annotations

import difflib


def near(name, known) -> str:
    """The known name that is nearest to a mistyped one, as a question; empty where none is near.

    >>> near("--smaples", ["--samples", "--scene"])
    'did you mean --samples?'
    >>> near("volpath", ["curve", "point"])
    ''
    """
    found = difflib.get_close_matches(name, list(known), n=1)
    return f"did you mean {found[0]}?" if found else ""


def advice(name, known) -> str:
    """What follows in a message on an unknown name: the nearest of those ``known``, and all of them.

    >>> advice("curv", ["curve", "interval", "point"])
    'did you mean curve? Known are curve, interval, point'
    >>> advice("volpath", ["curve", "interval", "point"])
    'known are curve, interval, point'
    """
    known = list(known)
    every, question = f"nown are {', '.join(known)}", near(name, known)
    return f"{question} K{every}" if question else f"k{every}"
