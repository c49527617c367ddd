"""A folder of synthetic logs: some good, one cut off, one that is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from synthetic_episode import ABOUT, Call, Synthetic, write_about

from tdpg_deploy.episode_log.about import About

HOSTILE = "<b>&\"'</script><script>document.title='owned'</script>"


def about(number: int, *, policy: str = "light") -> About:
    return replace(
        ABOUT, scene=None, seed=number, policy=policy, started_at=1.764e9 + 86_400 * number
    )


def hostile(call: Call) -> Call:
    """The same, with what a page prints made to break out of it."""
    match call.name, call.arguments:
        case "refused", (decision, reason):
            return replace(call, arguments=(decision, f"{reason} {HOSTILE}"))
        case "intend", (decision, plan):
            return replace(call, arguments=(decision, replace(plan, notes=(HOSTILE,))))
        case "end", (result,):
            return replace(call, arguments=(replace(result, error=HOSTILE),))
    return call


def make_logs(folder: Path, *, count: int = 3, actions: int = 3) -> None:
    for number in range(count):
        synthetic = Synthetic(seed=number)
        calls = synthetic.episode(actions, states=6)
        policy = "light"
        if number == 1:
            policy, calls = HOSTILE, [hostile(call) for call in calls]
        path = folder / f"night {number // 2}" / f"episode{number}.mcap"
        write_about(path, calls, about(number, policy=policy), now=synthetic.now)
    cut = folder / "cut.mcap.part"
    cut.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])
    (folder / "none.mcap").write_bytes(b"not a log")
