"""Serve the pages to this machine, and to no other."""

from __future__ import annotations

from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from rich.console import Console

from tdpg_deploy.errors import ConfigError

LOOPBACK = "127.0.0.1"


class _Quiet(SimpleHTTPRequestHandler):
    def send_head(self) -> Any:
        """Nothing to a page of another site whose name was made to lead here (DNS rebinding)."""
        if self.headers.get("Host", "").split(":")[0] not in (LOOPBACK, "localhost"):
            return self.send_error(HTTPStatus.FORBIDDEN, "These pages are for this machine")
        return super().send_head()

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing of every request."""


def open_server(folder: Path, port: int) -> ThreadingHTTPServer:
    """Port 0 takes any that is free. Raises ConfigError."""
    try:
        return ThreadingHTTPServer((LOOPBACK, port), partial(_Quiet, directory=str(folder)))
    except OSError as error:
        raise ConfigError(
            f"port {port} cannot be used ({error.strerror}): choose another one with --port"
        ) from error


def serve(folder: Path, port: int, console: Console) -> None:
    """Until Ctrl-C."""
    with open_server(folder, port) as server:
        console.print(f"http://{LOOPBACK}:{server.server_port}/  (Ctrl-C ends it)")
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            console.print("stopped")
