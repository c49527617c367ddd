"""What runs: versions of what is installed, and the commit of the source. For a log's head."""

from __future__ import annotations

import contextlib
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import tdpg_deploy

PACKAGES = (
    "numba",
    "numpy",
    "opencv-python-headless",
    "pybullet",
    "scipy",
    "torch",
    "ur-analytic-ik",
    "ur-rtde",
    "pyrealsense2",
)


def versions() -> dict[str, str]:
    """Of this program, Python, the machine, and the packages that decide or move."""
    installed = {package: _version(package) for package in PACKAGES}
    return {
        "tdpg-deploy": tdpg_deploy.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _processor(),
        **{package: number for package, number in installed.items() if number is not None},
    }


def _processor() -> str:
    """Its model: what a network computes is the same to the bit on the same one only."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def commit() -> str | None:
    """Of the checkout that this runs from, with "-dirty" if it was altered; None without one."""
    try:
        run = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=Path(tdpg_deploy.__file__).parent,
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return run.stdout.strip() or None
