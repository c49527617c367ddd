"""Docs are true: their links lead somewhere, their code runs, their tables are complete."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import BaseModel

from tdpg_deploy.cell_config import CellConfig, Pose

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if not target.startswith("https://"):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/checkpoint.md"])
def test_examples_run(page: str) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert blocks
    for code in blocks:
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=120)


@pytest.mark.parametrize("script", sorted(SCRIPTS))
def test_every_command_explains_itself(script: str) -> None:
    module, function = SCRIPTS[script].split(":")
    code = f"import sys; from {module} import {function} as main; sys.exit(main(['--help']))"
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert "usage: " + script in run.stdout


def test_the_cell_files_table_names_every_field() -> None:
    page = (ROOT / "docs" / "cell-file.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"`([a-z_A-Z.]+)`", page))
    missing = [field for field in _fields(CellConfig) if field not in documented]
    assert not missing


def _fields(model: type[BaseModel], prefix: str = "") -> list[str]:
    names = []
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel) and kind is not Pose:
            names += _fields(kind, f"{prefix}{name}.")
        else:
            names.append(prefix + name)
    return names
