"""What runs: versions of what is installed, and the commit of the source. For a log's head."""

from __future__ import annotations

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
INSTRUCTIONS = ("avx2", "avx512f", "avx512_bf16", "amx_bf16")  # torch computes by the widest


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
    try:
        return processor_of(Path("/proc/cpuinfo").read_text())
    except OSError:
        return platform.machine()


def processor_of(cpuinfo: str) -> str:
    """Model and widest instructions of the first one that Linux lists: what a network computes is
    the same to the bit on the same ones only. A name alone may be that of many ("AMD EPYC")."""
    lines = (line.partition(":") for line in cpuinfo.partition("\n\n")[0].splitlines())
    told = {name.strip(): value.strip() for name, _, value in lines}
    offered = set(told.get("flags", "").split())
    parts = [
        told.get("model name", platform.machine()),
        *(f"{key} {told[key]}" for key in ("cpu family", "model", "stepping") if key in told),
        *(name for name in INSTRUCTIONS if name in offered),
    ]
    return ", ".join(parts)


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
