"""Whose a directory is: what it was begun with stands in it, and nothing else may go on there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tdpg_deploy.errors import ConfigError


def claim(directory: Path, settings: dict[str, Any]) -> None:
    """Make the directory, or see to it that it was made for the same settings (JSON values).
    Raises ConfigError when it belongs to others."""
    directory.mkdir(parents=True, exist_ok=True)
    file = directory / "experiment.json"
    if not file.exists():
        file.write_text(json.dumps(settings, indent=2), encoding="utf-8")
    elif json.loads(file.read_text(encoding="utf-8")) != settings:
        raise ConfigError(
            f"{directory} holds another experiment (see {file}): give another directory, "
            "or the configuration that it was started with"
        )
