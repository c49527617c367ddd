"""What tdpg-audit does. What only some options need is imported where they ask for it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypeVar

from rich.console import Console
from rich.progress import track

from tdpg_deploy.errors import ConfigError
from tools.audit.compare import compare
from tools.audit.engines import Engine
from tools.audit.rows import AuditedLog
from tools.audit.run import audit_logs, find_logs
from tools.audit.site_build import Listed, listed, write_site
from tools.audit.summary import show_answer, show_comparison, show_summary
from tools.audit.tally import Tally

if TYPE_CHECKING:
    from tools.audit.parquet import TableWriter

T = TypeVar("T")


def audit(args: argparse.Namespace, console: Console) -> bool:
    """Returns whether every file was a log. Raises TdpgError."""
    if args.serve and args.html is None:
        raise ConfigError("--serve shows what --html wrote: give --html DIR too")
    with ExitStack() as stack:
        tables = args.out
        if tables is None and args.sql is not None:
            tables = Path(stack.enter_context(TemporaryDirectory(prefix="tdpg-audit-")))
        pages: list[Listed] | None = [] if args.html is not None else None
        tally = _read(args.logs, args, console, tables=tables, pages=pages)
        if args.sql is not None:
            with _extra():
                from tools.audit.sql import query
            show_answer(console, query(tables, args.sql))
        else:
            show_summary(console, args.logs, tally)
        if args.compare is not None:
            _compare(args, tally, console)
        if pages is not None:
            _write(args, pages, tally, console)
    if args.serve:
        from tools.audit.serve import serve

        serve(args.html, args.port, console)
    return not tally.unreadable


def _read(
    folder: Path,
    args: argparse.Namespace,
    console: Console,
    *,
    tables: Path | None = None,
    pages: list[Listed] | None = None,
) -> Tally:
    """Fills the folder `tables`, and `pages`, if there are to be any."""
    logs = find_logs(folder)
    tally = Tally()
    audited = audit_logs(
        folder, logs, workers=min(args.workers, len(logs)), engine=Engine(args.engine)
    )
    with nullcontext() if tables is None else _writer(tables) as writer:
        for log in _shown(audited, "reading", len(logs), console):
            tally.add(log)
            if isinstance(log, AuditedLog):
                if writer is not None:
                    writer.add(log)
                if pages is not None:
                    pages.append(listed(log))
    return tally


def _shown(done: Iterator[T], what: str, total: int, console: Console) -> Iterable[T]:
    """With a bar, where a person looks on."""
    hidden = not console.is_terminal
    return track(done, what, total, console=console, transient=True, disable=hidden)


def _writer(tables: Path) -> TableWriter:
    with _extra():
        from tools.audit.parquet import TableWriter
    return TableWriter(tables)


@contextmanager
def _extra() -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as error:
        raise ConfigError(f"{error.name} is missing: pip install 'tdpg-deploy[audit]'") from error


def _compare(args: argparse.Namespace, tally: Tally, console: Console) -> None:
    other = _read(args.compare, args, console)
    for folder, one in ((args.logs, tally), (args.compare, other)):
        if not one.rows:
            raise ConfigError(f"{folder}: no complete episode to compare")
    show_comparison(console, args.logs, args.compare, compare(tally, other))


def _write(args: argparse.Namespace, pages: list[Listed], tally: Tally, console: Console) -> None:
    workers, engine = min(args.workers, len(pages) or 1), Engine(args.engine)
    done = write_site(args.html, pages, tally, workers=workers, engine=engine)
    for _ in _shown(done, "writing pages", len(pages), console):
        pass
    console.print(f"pages: {args.html / 'index.html'}", markup=False, soft_wrap=True)
