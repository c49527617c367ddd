"""tdpg-replay: look at a logged episode again, decide on it again, try it again."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tdpg_deploy.arguments import positive

EPILOG = """\
examples:
  tdpg-replay LOG --step                        one step after the other
  tdpg-replay LOG --policy CHECKPOINT           decided again: the same, bit for bit?
  tdpg-replay LOG --move-camera "5 mm,0,0"      what if the camera was moved?
  tdpg-replay LOG --reenact --from 3            try the third action in the simulated cell
  tdpg-replay LOG --rerun                       open it in Rerun

exit codes:
  0    played; decided again: the same
  1    decided again: another action, or other bits on the same processor
  2    bad input: arguments, checkpoint, cell file, a file that is no log
  3    the log is damaged; what can be read was played
  130  Ctrl-C
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="tdpg-replay",
        description=__doc__.removeprefix("tdpg-replay: ") if __doc__ else None,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("log", type=Path, metavar="LOG")
    p.add_argument("--from", dest="first", type=positive, default=1, metavar="N", help="first step")

    terminal = p.add_argument_group("in the terminal")
    terminal.add_argument("--step", action="store_true", help="wait after each step")
    terminal.add_argument("--against", type=Path, metavar="LOG2", help="another log, side by side")

    again = p.add_argument_group("decide again")
    again.add_argument(
        "--policy",
        metavar="FILE",
        help='a checkpoint, or "random" (default with the options below: the log\'s)',
    )
    again.add_argument("--config", type=Path, metavar="FILE", help="with another cell file")
    again.add_argument(
        "--move-camera",
        metavar="X,Y,Z",
        help='as if the camera hung elsewhere: "5 mm,0,0" of base (metres, or with a unit)',
    )

    elsewhere = p.add_argument_group(
        "elsewhere than in the terminal"
    ).add_mutually_exclusive_group()
    elsewhere.add_argument(
        "--reenact",
        action="store_true",
        help="try the logged action of step N in the simulated cell: an estimate",
    )
    elsewhere.add_argument("--video", type=Path, metavar="OUT.mp4", help="write a video")
    elsewhere.add_argument("--rerun", action="store_true", help="open it in Rerun")
    elsewhere.add_argument("--rrd", type=Path, metavar="OUT.rrd", help="write it for Rerun")
    elsewhere.add_argument("--foxglove", action="store_true", help="play it live to Foxglove")
    p.add_argument("--speed", type=_speed, default=1.0, metavar="X", help="of video and Foxglove")
    return p


def _speed(text: str) -> float:
    try:
        if 0.01 <= float(text) <= 100:
            return float(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text} is not a number within 0.01 to 100")


def main(argv: Sequence[str] | None = None) -> int:
    options = parser()
    args = options.parse_args(argv)
    decides = [args.policy, args.config, args.move_camera]
    others = [args.against, args.reenact, args.video, args.rerun, args.rrd, args.foxglove]
    if any(decides) and any(others):
        options.error(
            "--policy, --config and --move-camera decide again in the terminal: not allowed with "
            "--against, --reenact, --video, --rerun, --rrd and --foxglove"
        )

    from tools.replay.command import replay  # heavy: not for --help

    return replay(args)


if __name__ == "__main__":
    sys.exit(main())
