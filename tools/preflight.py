"""Say what this machine lacks before anything is installed. Runs on any Python from 3.7."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from collections.abc import Iterator

NEEDED_GB = 4.0  # the environment takes 2.6 GB, pip's temporary files the rest


def problems() -> Iterator[str]:
    """Yield one line for each thing that is missing, with what to do."""
    if not (3, 10) <= sys.version_info[:2] <= (3, 11):
        yield (
            f"Python {sys.version_info[0]}.{sys.version_info[1]} found, 3.11 or 3.10 needed "
            "(pybullet has no wheels for others): "
            "install python3.11 and run `make PYTHON=python3.11 ...`"
        )
    for module in ("venv", "ensurepip"):
        if importlib.util.find_spec(module) is None:
            version = f"{sys.version_info[0]}.{sys.version_info[1]}"
            yield f"module {module} is missing: apt install python{version}-venv"
    free = shutil.disk_usage(".").free / 1e9
    if free < NEEDED_GB:
        yield f"{free:.1f} GB free on this disk, {NEEDED_GB} GB needed: free some space"


if __name__ == "__main__":
    found = list(problems())
    sys.exit("\n".join(found) if found else 0)
