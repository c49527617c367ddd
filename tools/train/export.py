"""tdpg-export: freeze what a run has learnt into a policy file, with its card beside it."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

PAPER_BUDGET = 4000  # steps (paper, section III-D)


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-export",
        description=__doc__,
        epilog="Works while the run goes on, too. exit codes: 0 written; 2 bad input",
    )
    p.add_argument("run", type=Path, metavar="RUN_DIR", help="--out of tdpg-train")
    p.add_argument("out", type=Path, metavar="OUT.safetensors")
    p.add_argument("--method", metavar="NAME", help="that the policy decides by, not the run's")
    p.add_argument(
        "--goal", action="store_true", help="as a policy that fetches: a twin's weights do both"
    )
    p.add_argument("--note", default="", metavar="TEXT", help="for the card")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    args = parser().parse_args(argv)

    from rich.console import Console

    from policies.errors import PolicyError
    from tdpg_deploy.errors import TdpgError

    console = Console()
    try:
        sha256 = export(args.run, args.out, method=args.method, goal=args.goal, note=args.note)
    except (PolicyError, TdpgError) as error:
        console.print(str(error), style="red", markup=False)
        return 2
    console.print(f"{args.out}: SHA-256 {sha256}; card: {args.out.with_suffix('.md')}")
    return 0


def export(
    run: Path, out: Path, *, method: str | None = None, goal: bool = False, note: str = ""
) -> str:
    """method: see `methods.METHODS`; the run's when not given. goal: as a policy that reads a goal,
    which a twin's weights are too. Returns the policy's SHA-256.

    Raises PolicyError, and ConfigError for a bad name.
    """
    from dataclasses import replace

    from policies.checkpoint import load_checkpoint, save_checkpoint
    from policies.methods import METHODS
    from tdpg_deploy.errors import ConfigError
    from tools.train.curve import read_curve
    from tools.train.run import WEIGHTS

    if out.suffix != ".safetensors":
        raise ConfigError(f"{out}: a policy file ends in .safetensors")
    if method is not None and method not in METHODS:
        raise ConfigError(f"no method {method}: one of {', '.join(METHODS)}")
    frozen = load_checkpoint(run / WEIGHTS)
    if goal and frozen.config.network != "twin" and not frozen.config.goal:
        raise ConfigError(
            f"--goal: the weights of a network {frozen.config.network} that clears tables read no "
            "goal; those of a twin do"
        )
    config = replace(
        frozen.config,
        method=method or frozen.config.method,
        goal=goal or frozen.config.goal,
    )
    lines = [line for line in read_curve(run) if line["actions"] <= frozen.provenance["actions"]]
    validated = [line for line in lines if line["validation"]]
    provenance = dict(frozen.provenance)
    if validated:
        provenance["validation"] = validated[-1]["validation"]
    provenance["note"] = note
    out.parent.mkdir(parents=True, exist_ok=True)
    sha256 = save_checkpoint(out, frozen.network(), config, provenance)
    card = card_of(out.stem, vars(config), provenance, sha256)
    out.with_suffix(".md").write_text(card, encoding="utf-8")
    return sha256


def card_of(
    name: str, config: Mapping[str, Any], provenance: Mapping[str, Any], sha256: str
) -> str:
    """The card, as Markdown."""
    experiment = provenance["experiment"]
    start = provenance.get("start")
    actions = provenance["actions"] + (start["actions"] if start else 0)
    budget = "within" if actions <= PAPER_BUDGET else "beyond"
    figures = _figures(provenance.get("validation") or {})
    task = "fetches one object, whose pixels it is told" if config["goal"] else "clears the table"
    sections = [
        f"# {name}",
        provenance["note"],
        f"A policy that {task}. Method {config['method']}, network {config['network']} of width "
        f"{config['width']}. SHA-256 `{sha256}`.",
        "## Training",
        f"{actions} actions, {budget} the paper's budget of {PAPER_BUDGET}; "
        f"{provenance['updates']} updates in the last run. Simulated tables of random objects, "
        "with the D435's noise and the randomisation below. Nothing real was learnt from.",
        f"{start['actions']} of the actions made the weights that it began with, "
        f"`{start['sha256']}`."
        if start
        else "It began with fresh weights.",
        f"Made by tdpg-train of commit `{provenance.get('commit') or 'unknown'}` with the "
        "experiment below.",
        "## Figures while training",
        "On validation tables; see docs/results.md for the test.\n\n"
        + "\n".join(f"- {line}" for line in figures or ["none were taken"]),
        "## Experiment",
        f"```json\n{json.dumps(experiment, indent=2)}\n```",
    ]
    return "\n\n".join(section for section in sections if section) + "\n"


def _figures(validation: Mapping[str, Any], of: str = "") -> list[str]:
    """A line for each figure, those of a part under its name."""
    lines = []
    for name, value in validation.items():
        if isinstance(value, Mapping):
            lines += _figures(value, f"{of}{name}, ")
        elif value is not None:
            lines.append(f"{of}{name}: {value:.3f}")
    return lines


if __name__ == "__main__":
    sys.exit(main())
