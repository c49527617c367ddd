"""Say what this machine lacks before anything is installed. Runs on any Python 3."""

import importlib.util
import shutil
import sys

NEEDED_GB = 4.0  # the environment takes 2.6 GB, pip's temporary files the rest


def problems():
    """Yield one line for each thing that is missing, with what to do."""
    if not (3, 10) <= sys.version_info[:2] <= (3, 11):
        yield (
            "Python {}.{} found, 3.11 or 3.10 needed (pybullet has no wheels for others): "
            "install python3.11 and run `make PYTHON=python3.11 ...`".format(*sys.version_info)
        )
    for module in ("venv", "ensurepip"):
        if importlib.util.find_spec(module) is None:
            yield "module {} is missing: apt install python{}.{}-venv".format(
                module, *sys.version_info
            )
    free = shutil.disk_usage(".").free / 1e9
    if free < NEEDED_GB:
        yield "{:.1f} GB free on this disk, {} GB needed: free some space".format(free, NEEDED_GB)


if __name__ == "__main__":
    found = list(problems())
    sys.exit("\n".join(found) if found else 0)
