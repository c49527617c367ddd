"""The pictures of an episode's page, as they are logged."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from tdpg_deploy.episode_log import channels, documents, messages
from tdpg_deploy.episode_log.entries import LookDocument
from tdpg_deploy.episode_log.reader import Episode
from tdpg_deploy.errors import LogError

_LOOKS = {
    channels.PREVIEW: "camera.jpg",
    channels.COLOR: "camera.jpg",
    channels.HEIGHTMAP_COLOR: "map.png",
}
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
    waiting: dict[str, bytes] = {}  # until the document that closes them
    with suppress(LogError):  # told by the record's evidence
        topics = {*_LOOKS, *_Q_MAPS, channels.LOOK, channels.DECISION} - {_camera_unread(episode)}
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


def _camera_unread(episode: Episode) -> str:
    """The first logs had no previews: those are made of the camera's own pictures, at three times
    the cost of all else on the page."""
    for _ in episode.raw({channels.PREVIEW}):
        return channels.COLOR
    return channels.PREVIEW


def _write(
    folder: Path, prefix: str, waiting: dict[str, bytes], names: dict[str, str]
) -> dict[str, str]:
    written = {}
    for topic, name in names.items():
        if topic not in waiting:
            continue
        message = messages.parse(CompressedImage, waiting.pop(topic))
        if topic == channels.COLOR:
            message = messages.encode_preview(messages.decode_picture(message), 0, "")
        file = f"{prefix}-{name}"
        (folder / file).write_bytes(message.data)
        written[name.partition(".")[0]] = file
    return written
