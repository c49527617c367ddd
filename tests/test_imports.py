"""Who may import whom, read from the sources; and what a light command may load."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OURS = ("tdpg_deploy", "calibration", "policies", "tools", "tests")

FOUNDATION = [
    "tdpg_deploy.errors",
    "tdpg_deploy.geometry",
    "tdpg_deploy.cell_config",
    "tdpg_deploy.calibration_file",
    "tdpg_deploy.depth_model",
    "tdpg_deploy.hal",
]
COMPILER = ["tdpg_deploy.compiled"]
VALUES = [
    "policies.heightmap",
    "policies.primitives",
    "policies.policy",
    "policies.gripper",
    "policies.errors",
]
STEP = ["tdpg_deploy.plan", "tdpg_deploy.outcome"]

# The first matching prefix rules. None: may import everything but what nobody may.
MAY_IMPORT: dict[str, list[str] | None] = {
    "policies": ["policies"],
    "calibration": ["calibration", "tdpg_deploy"],
    "tdpg_deploy.errors": [],
    "tdpg_deploy.geometry": [],
    "tdpg_deploy.cell_config": [*FOUNDATION, "tdpg_deploy.kinematics"],
    "tdpg_deploy.hal": FOUNDATION,
    "tdpg_deploy.calibration_file": FOUNDATION,
    "tdpg_deploy.depth_model": [],
    "tdpg_deploy.calibrated_camera": FOUNDATION,
    "tdpg_deploy.plan": FOUNDATION + VALUES,
    "tdpg_deploy.outcome": [],
    "tdpg_deploy.kinematics": FOUNDATION,
    "tdpg_deploy.compiled": [],
    "tdpg_deploy.markers": [],
    "tdpg_deploy.averaging": COMPILER,
    "tdpg_deploy.workspace": [*FOUNDATION, "policies.heightmap"],
    "tdpg_deploy.perception": FOUNDATION + VALUES + COMPILER,
    "tdpg_deploy.footprint": [*FOUNDATION, *VALUES],
    "tdpg_deploy.motion": [
        *FOUNDATION, *VALUES, *STEP, "tdpg_deploy.kinematics", "tdpg_deploy.footprint",
    ],
    "tdpg_deploy.safety": [*FOUNDATION, *STEP, "tdpg_deploy.kinematics"],
    "tdpg_deploy.sim": [
        *FOUNDATION, *COMPILER, "policies.heightmap", "tdpg_deploy.sim", "tdpg_deploy.kinematics",
        "tdpg_deploy.averaging", "tdpg_deploy.markers", "tdpg_deploy.workspace",
    ],
    "tdpg_deploy.drivers": [
        *FOUNDATION, "tdpg_deploy.drivers", "tdpg_deploy.kinematics", "tdpg_deploy.averaging",
    ],
    "tdpg_deploy.emulators": [
        *FOUNDATION, "tdpg_deploy.emulators", "tdpg_deploy.sim", "tdpg_deploy.drivers",
        "tdpg_deploy.kinematics",
    ],
    "tdpg_deploy.foresight": [
        *FOUNDATION, *VALUES, *STEP, "policies", "tdpg_deploy.foresight", "tdpg_deploy.cell",
        "tdpg_deploy.sim", "tdpg_deploy.perception", "tdpg_deploy.motion", "tdpg_deploy.safety",
        "tdpg_deploy.execution", "tdpg_deploy.workspace",
    ],
    "tdpg_deploy": None,
    "tools": None,
    "tests": None,
}  # fmt: skip
NOBODY_MAY = {"tdpg_deploy.cli": ("tests",), "tools": ("tools", "tests"), "tests": ("tests",)}


def modules() -> Iterator[tuple[str, Path]]:
    for top in OURS:
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


def our_imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name for name in names if within(name, OURS))


def within(name: str, prefixes: list[str] | tuple[str, ...]) -> bool:
    return any(name == prefix or name.startswith(prefix + ".") for prefix in prefixes)


def rule(module: str) -> list[str] | None:
    prefix = max((p for p in MAY_IMPORT if within(module, [p])), key=len)
    return MAY_IMPORT[prefix]


@pytest.mark.parametrize(("module", "path"), list(modules()))
def test_imports_go_in_one_direction(module: str, path: Path) -> None:
    allowed = rule(module)
    for name in our_imports(path):
        for forbidden, exempt in NOBODY_MAY.items():
            if within(name, [forbidden]):
                own = within(module, [forbidden]) or within(module, exempt)
                assert own, f"{module} imports {name}"
        if allowed is not None:
            assert within(name, allowed), f"{module} imports {name}; allowed: {allowed}"


@pytest.mark.parametrize(
    ("module", "absent"),
    [
        ("tdpg_deploy.cli.run", ["torch", "pybullet", "cv2", "numba", "scipy", "mcap"]),
        ("tools.train.cli", ["torch", "pybullet", "cv2", "numba", "scipy", "mcap"]),
    ],
)
def test_light_modules_stay_light(module: str, absent: list[str]) -> None:
    code = f"import sys, {module}; print([m for m in {absent} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_calibration_loads_neither_torch_nor_policies() -> None:
    """Not even by way of what it imports."""
    code = (
        "import importlib, pkgutil, sys, calibration\n"
        "for m in pkgutil.iter_modules(calibration.__path__, 'calibration.'):\n"
        "    importlib.import_module(m.name)\n"
        "print('calibration.solve' in sys.modules, [m for m in sys.modules\n"
        "    if m.split('.')[0] in ('torch', 'policies', 'pybullet', 'pyrealsense2')])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "True []"


def test_real_is_known_in_one_place() -> None:
    """Only open_cell decides by `real`; the command line asks before, others hand it on."""
    deciding = set()
    for module, path in modules():
        if not module.startswith(("tdpg_deploy", "policies", "calibration")):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.If | ast.IfExp | ast.While) and "real" in names_in(node.test):
                deciding.add(module)
    asking = {"tdpg_deploy.cli.session", "calibration.consent"}
    assert deciding == {"tdpg_deploy.cell", *asking}


def names_in(expression: ast.expr) -> set[str]:
    nodes = list(ast.walk(expression))
    return {node.id for node in nodes if isinstance(node, ast.Name)} | {
        node.attr for node in nodes if isinstance(node, ast.Attribute)
    }
