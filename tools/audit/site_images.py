"""The pictures of an episode's page: heightmaps and Q-maps as they are logged, the camera's
pictures made small."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from tdpg_deploy.episode_log import channels, documents, messages
from tdpg_deploy.episode_log.entries import LookDocument
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import LogError

CAMERA_WIDTH = 640  # pixels
QUALITY = 82  # of JPEG

_LOOKS = {channels.COLOR: "camera.jpg", channels.HEIGHTMAP_COLOR: "map.png"}
_Q_MAPS = {channels.Q_PUSH: "push.png", channels.Q_GRASP: "grasp.png"}


@dataclass(frozen=True, kw_only=True)
class Images:
    """Names of files. looks: by the frame's sequence number, kind -> file. q_maps: of each
    decision that was acted on, kind -> file."""

    looks: dict[str, dict[str, str]]
    q_maps: list[dict[str, str]]


def write_images(episode: Episode, folder: Path) -> Images:
    """Of a damaged log, what can be read."""
    folder.mkdir(exist_ok=True)
    images = Images(looks={}, q_maps=[])
    topics = {*_LOOKS, *_Q_MAPS, channels.LOOK, channels.DECISION}
    waiting: dict[str, bytes] = {}  # until the document that closes them
    with suppress(LogError):  # told by the record's evidence
        for topic, content in episode.raw(topics):
            if topic == channels.LOOK:
                sequence = documents.decode(LookDocument, content).sequence
                name = f"look{len(images.looks) + 1}"
                images.looks[str(sequence)] = _write(folder, name, waiting, _LOOKS)
            elif topic == channels.DECISION:
                name = f"q{len(images.q_maps) + 1}"
                images.q_maps.append(_write(folder, name, waiting, _Q_MAPS))
            else:
                waiting[topic] = content
    return images


def _write(
    folder: Path, prefix: str, waiting: dict[str, bytes], names: dict[str, str]
) -> dict[str, str]:
    written = {}
    for topic, name in names.items():
        if topic not in waiting:
            continue
        message = messages.parse(CompressedImage, waiting.pop(topic))
        file = f"{prefix}-{name}"
        small = name.endswith(".jpg")
        (folder / file).write_bytes(_small_jpeg(message) if small else message.data)
        written[name.partition(".")[0]] = file
    return written


def _small_jpeg(message: CompressedImage) -> bytes:
    bgr = messages.decode_bgr(message)
    height = round(CAMERA_WIDTH * bgr.shape[0] / bgr.shape[1])
    small = cv2.resize(bgr, (CAMERA_WIDTH, max(height, 1)), interpolation=cv2.INTER_AREA)
    done, jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    return jpeg.tobytes()
