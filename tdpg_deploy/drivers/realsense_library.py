"""pyrealsense2, also where libusb is not installed for the whole system."""

from __future__ import annotations

import ctypes
from typing import Any

from tdpg_deploy.errors import DeviceUnreachable


def load_realsense() -> Any:
    """The module `pyrealsense2`. Raises DeviceUnreachable when it is not installed.

    Its wheel wants the system's libusb-1.0.so.0; the one of `libusb-package`, loaded before,
    will do.
    """
    try:
        _provide_libusb()
        import pyrealsense2
    except ImportError as error:
        raise DeviceUnreachable(
            f"pyrealsense2 cannot be loaded ({error}): pip install 'tdpg-deploy[real]'"
        ) from error
    return pyrealsense2


def _provide_libusb() -> None:
    try:
        ctypes.CDLL("libusb-1.0.so.0")
    except OSError:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
