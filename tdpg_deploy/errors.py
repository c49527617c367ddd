"""What `tdpg_deploy` and `calibration` can raise.

    TdpgError
    ├── ConfigError            the cell file: field, value, allowed range
    ├── SceneError             a scene file, or objects that do not fit
    ├── FrameError             a camera frame that cannot be used
    ├── CalibrationError       missing, stale, mismatching or degenerate calibration
    ├── LogError               an episode log that cannot be written or read
    ├── PlanRefused            a plan that `check` does not let pass; nothing has moved
    └── DeviceError            a device did not do what was asked
        ├── DeviceUnreachable  no connection, or it was lost
        ├── DeviceTimeout      no answer before the deadline
        ├── CameraError        no frame, or a stale one
        ├── ArmError           the arm refused or could not finish a motion
        │   ├── ProtectiveStop     stopped by the controller; needs a person
        │   └── EmergencyStop      e-stop or safeguard stop; needs a person
        └── GripperError       fault, or not activated

A message says what happened, with the value, and what to do.
"""

from __future__ import annotations


class TdpgError(Exception):
    """Base of everything raised on purpose by `tdpg_deploy` and `calibration`."""


class ConfigError(TdpgError):
    """The cell file is wrong; the message names field, value and allowed range."""


class SceneError(TdpgError):
    """A scene file is wrong, or its objects do not fit into the workspace."""


class FrameError(TdpgError):
    """A camera frame cannot be used: wrong shape, empty, torn."""


class CalibrationError(TdpgError):
    """A calibration is missing, stale, made for another device, or cannot be determined."""


class LogError(TdpgError):
    """An episode log cannot be written, or a file is not one that can be read."""


class PlanRefused(TdpgError):
    """`check` does not let this plan pass. Nothing has moved."""


class DeviceError(TdpgError):
    """A device did not do what was asked."""


class DeviceUnreachable(DeviceError):
    """No connection to the device, or the connection was lost."""


class DeviceTimeout(DeviceError):
    """The device did not answer or finish before the deadline."""


class CameraError(DeviceError):
    """The camera delivers no frame, or only stale ones."""


class ArmError(DeviceError):
    """The arm refused a motion or could not finish it."""


class ProtectiveStop(ArmError):
    """The controller stopped the arm to protect it. A person has to look and release it."""


class EmergencyStop(ArmError):
    """Emergency or safeguard stop. A person has to release it."""


class GripperError(DeviceError):
    """The gripper reports a fault or is not activated."""
