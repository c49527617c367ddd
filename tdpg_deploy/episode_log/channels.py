"""The channels of a log: topics and the types that they carry. docs/log.md describes them.

Sensor channels carry foxglove.* protobuf messages, which Foxglove and Rerun draw without a
plug-in (messages.py); the rest are JSON documents (documents.py).
"""

from __future__ import annotations

from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from tdpg_deploy.episode_log.entries import (
    Conclusion,
    End,
    ForceDocument,
    LoggedDecision,
    LookDocument,
    PlanDocument,
    Refusal,
)
from tdpg_deploy.hal import GripperState

COLOR = "/camera/color"
PREVIEW = "/camera/preview"
DEPTH = "/camera/depth"
CALIBRATION = "/camera/calibration"
TRANSFORMS = "/tf"
HEIGHTMAP = "/heightmap"
HEIGHTMAP_RIM = "/heightmap/rim"
HEIGHTMAP_COLOR = "/heightmap/color"
HEIGHTMAP_POINTS = "/heightmap/points"
Q_PUSH = "/q_map/push"
Q_GRASP = "/q_map/grasp"
PLAN_SCENE = "/plan/scene"
PLAN_POSES = "/plan/poses"
JOINTS = "/joint_states"
LOG_LINES = "/log"
LOOK = "/look"
REFUSAL = "/refusal"
DECISION = "/decision"
PLAN = "/plan"
TOOL_FORCE = "/tool/force"
GRIPPER = "/gripper"
OUTCOME = "/outcome"
RESULT = "/result"

PROTOBUF: dict[str, Any] = {
    COLOR: CompressedImage,
    PREVIEW: CompressedImage,
    DEPTH: RawImage,
    CALIBRATION: CameraCalibration,
    TRANSFORMS: FrameTransforms,
    HEIGHTMAP: Grid,
    HEIGHTMAP_RIM: Grid,
    HEIGHTMAP_COLOR: CompressedImage,
    HEIGHTMAP_POINTS: PointCloud,
    Q_PUSH: CompressedImage,
    Q_GRASP: CompressedImage,
    PLAN_SCENE: SceneUpdate,
    PLAN_POSES: PosesInFrame,
    JOINTS: JointStates,
    LOG_LINES: Log,
}

DOCUMENTS: dict[str, Any] = {
    LOOK: LookDocument,
    REFUSAL: Refusal,
    DECISION: LoggedDecision,
    PLAN: PlanDocument,
    TOOL_FORCE: ForceDocument,
    GRIPPER: GripperState,
    OUTCOME: Conclusion,
    RESULT: End,
}
PICTURES = frozenset({PREVIEW, HEIGHTMAP_COLOR, Q_PUSH, Q_GRASP})  # what a page shows
MEASURED = frozenset({COLOR, DEPTH, CALIBRATION, HEIGHTMAP, HEIGHTMAP_RIM, HEIGHTMAP_POINTS})
IMAGES = PICTURES | MEASURED


def chunk_of(topic: str) -> str:
    """What a chunk with messages on `topic` holds, and nothing else: whoever reads one kind need
    not unpack the others."""
    return "picture" if topic in PICTURES else "measured" if topic in MEASURED else "document"


BASE = "base"
TOOL = "tool"
CAMERA = "camera_color_optical_frame"
MAP = "heightmap"  # of pictures on the heightmap's grid; Rerun warns of those without a frame
