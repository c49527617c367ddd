"""Pictures and poses that somebody else recorded: a folder, a pose table, a lens file.

The pose table is CSV with a header: `image,x,y,z,rx,ry,rz` (rotation vector, radians, as UR
controllers print it) or `image,x,y,z,qx,qy,qz,qw`; metres; the tool's pose in base. Lines that
begin with # are skipped. The lens file is YAML: width, height, fx, fy, cx, cy, and distortion
(k1, k2, p1, p2, k3), or ROS's camera_info with camera_matrix and distortion_coefficients.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from calibration.detect import detect
from calibration.target import CharucoTarget
from calibration.views import View
from tdpg_deploy.calibration_file import read_yaml
from tdpg_deploy.errors import CalibrationError
from tdpg_deploy.geometry import Array, Transform
from tdpg_deploy.hal import Intrinsics

ROTATION_VECTOR = ("x", "y", "z", "rx", "ry", "rz")
QUATERNION = ("x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, kw_only=True, eq=False)
class Rejected:
    """A picture that is not used, and why."""

    name: str
    problems: tuple[str, ...]


def read_views(
    images: Path, poses: Path, target: CharucoTarget, lens: Intrinsics
) -> tuple[list[View], list[Rejected]]:
    """Detect the board in every picture that the table names. Raises CalibrationError."""
    views, rejected = [], []
    for name, X_base_tool in read_poses(poses).items():
        found = detect(read_picture(images / name, lens), target)
        if found.problems:
            rejected.append(Rejected(name=name, problems=found.problems))
            continue
        views.append(View(name=name, X_base_tool=X_base_tool, ids=found.ids, corners=found.corners))
    return views, rejected


def read_picture(path: Path, lens: Intrinsics) -> npt.NDArray[np.uint8]:
    """(H, W) grey. Raises CalibrationError."""
    if not path.is_file():
        raise CalibrationError(f"{path}: there is no such picture")
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise CalibrationError(f"{path}: not a picture that can be read; give PNG or JPEG")
    if picture.shape != (lens.height, lens.width):
        raise CalibrationError(
            f"{path}: {picture.shape[1]} x {picture.shape[0]} pixels, but the intrinsics are for "
            f"{lens.width} x {lens.height}: use those of this stream"
        )
    return np.asarray(picture, np.uint8)


def read_poses(path: Path) -> dict[str, Transform]:
    """X_base_tool by picture. Raises CalibrationError that names line and unit."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: cannot be read: {error}") from error
    rows = csv.DictReader(
        (line for line in lines if line.strip() and not line.startswith("#")),
        skipinitialspace=True,
    )
    header = tuple(name.strip() for name in rows.fieldnames or ())
    columns = next((c for c in (ROTATION_VECTOR, QUATERNION) if header[1:] == c), None)
    if columns is None or header[0] != "image":
        raise CalibrationError(
            f"{path}: its header is {','.join(header)!r}; give image,{','.join(ROTATION_VECTOR)} "
            f"or image,{','.join(QUATERNION)}"
        )
    names: list[str] = []
    values: list[list[float]] = []
    for row in rows:
        name = (row["image"] or "").strip()
        try:
            values.append([float(row[column]) for column in columns])
        except (TypeError, ValueError) as error:
            raise CalibrationError(f"{path}: {name}: needs {len(columns)} numbers") from error
        if name in names:
            raise CalibrationError(f"{path}: {name} has two poses: remove one")
        names.append(name)
    if not names:
        raise CalibrationError(f"{path}: has no poses")
    table = np.array(values)
    check_units(table, source=str(path))
    if columns is QUATERNION:
        poses = [Transform.from_quaternion(row[:3], row[3:]) for row in table]
    else:
        poses = [Transform.from_rotation_vector(row) for row in table]
    return dict(zip(names, poses, strict=True))


def check_units(table: Array, *, source: str) -> None:
    """table: (n, 6) or (n, 7) as written. Raises CalibrationError."""
    if not np.isfinite(table).all():
        raise CalibrationError(f"{source}: row {int(np.argmin(np.isfinite(table).all(1)))} has nan")
    farthest = float(np.linalg.norm(table[:, :3], axis=1).max())
    if farthest > 5.0:
        raise CalibrationError(
            f"{source}: a tool {farthest:.4g} from the base: are the poses in mm? Give metres"
        )
    turns = np.linalg.norm(table[:, 3:], axis=1)
    if table.shape[1] == 7 and np.abs(turns - 1).max() > 1e-2:
        raise CalibrationError(
            f"{source}: a quaternion has norm {turns[np.abs(turns - 1).argmax()]:.3f}, not 1"
        )
    if table.shape[1] == 6 and turns.max() > 2 * np.pi + 0.1:
        raise CalibrationError(
            f"{source}: a rotation vector is {turns.max():.4g} long, more than a full turn: is it "
            "in degrees, or roll, pitch, yaw? Give a rotation vector in radians"
        )


def read_lens(path: Path) -> Intrinsics:
    """Raises CalibrationError."""
    data = read_yaml(path)
    try:
        if "camera_matrix" in data:
            k = [float(v) for v in data["camera_matrix"]["data"]]
            d = [float(v) for v in data["distortion_coefficients"]["data"]]
            size = int(data["image_width"]), int(data["image_height"])
            return _lens(size, (k[0], k[4], k[2], k[5]), d)
        size = int(data["width"]), int(data["height"])
        pinhole = tuple(float(data[name]) for name in ("fx", "fy", "cx", "cy"))
        return _lens(size, pinhole, [float(v) for v in data.get("distortion", [])])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise CalibrationError(
            f"{path}: {what}; give width, height, fx, fy, cx, cy and distortion "
            "[k1, k2, p1, p2, k3]"
        ) from error


def _lens(size: tuple[int, int], pinhole: Sequence[float], distortion: list[float]) -> Intrinsics:
    if len(distortion) > 5 and any(distortion[5:]):
        raise ValueError("the distortion has more than five terms")
    k1, k2, p1, p2, k3 = [*distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    fx, fy, cx, cy = pinhole
    if not (fx > 0 and fy > 0 and 0 < cx < size[0] and 0 < cy < size[1]):
        raise ValueError(
            f"focal lengths ({fx}, {fy}) and a principal point ({cx}, {cy}) do not belong to "
            f"pictures of {size[0]} x {size[1]}"
        )
    return Intrinsics(
        width=size[0],
        height=size[1],
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        distortion=(k1, k2, p1, p2, k3),
    )
