"""The form of all measured results: ``results.json`` = {schema, version, machine, rows}."""

from __future__ import annotations

import json
import os
import platform as host
from pathlib import Path

import mitsuba_refscatter

from .. import image_io

SCHEMA = "refscatter-results-1"

ROW = (
    "scene", "method", "variant", "triangles", "settings", "wall_seconds", "cpu_seconds", "samples",
    "relmse", "mean_relative_error", "p99_relative_error", "bias", "flip",
)  # fmt: skip
"""What every row has; null where it was not measured. Commands add keys of their own."""


def row(**values) -> dict:
    """A row with all keys of ``ROW``.

    >>> found = row(scene="sphere", light="envmap")
    >>> found["scene"], found["light"], found["wall_seconds"]
    ('sphere', 'envmap', None)
    """
    return {**dict.fromkeys(ROW), **values}


def machine() -> dict:
    """What the figures were measured on."""
    name = host.processor() or host.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:
            name = next((line.split(":", 1)[1].strip() for line in info if line.startswith("model name")), name)
    except OSError:
        pass  # not Linux: the short name does
    return {"processor": name, "cores": os.cpu_count(), "system": host.platform()}


def write(directory: str | Path, rows: list[dict]) -> Path:
    """Write ``results.json`` to a directory, beside it first and then renamed; return its path."""
    path = Path(directory) / "results.json"
    data = {"schema": SCHEMA, "version": mitsuba_refscatter.__version__, "machine": machine(), "rows": rows}
    image_io.write_file(
        path, lambda unfinished: unfinished.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    )
    return path
