"""Clients that others wrote on the emulated controller: ur_rtde's three interfaces."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from ur_rig import emulated_controller, new_host

SESSION = Path(__file__).with_name("ur_rtde_session.py")


@pytest.mark.slow
@pytest.mark.parametrize(("generation", "major"), [("cb3", 3), ("e-series", 5)])
def test_ur_rtde(generation: str, major: int) -> None:
    host = new_host()
    with emulated_controller(host, generation=generation, pace=2.0):
        command = [sys.executable, str(SESSION), host, str(major)]
        result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
        assert "all well" in result.stdout, result.stderr
