"""The pages: what they carry, that nothing in a log can break out, and a walk in a browser."""

from __future__ import annotations

import json
import queue
import re
import shutil
import subprocess
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from html.parser import HTMLParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import pytest
from audited_logs import HOSTILE, make_logs

from tdpg_deploy.episode_log.reader import read_episode
from tools.audit.cli import main
from tools.audit.serve import open_server
from tools.audit.site_build import as_script_data, slug
from tools.audit.site_images import write_images

FIRST_SCHEMA = Path(__file__).parents[2] / "tdpg_deploy/episode_log/data/schema_1.mcap"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("audit")
    make_logs(folder / "logs")
    main([str(folder / "logs"), "--workers", "1", "--html", str(folder / "site")])
    return folder / "site"


class Elements(HTMLParser):
    """Names of the elements, and the text of the JSON one."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: list[str] = []
        self.json = ""
        self._in_json = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.append(tag)
        self._in_json = ("type", "application/json") in attrs

    def handle_data(self, data: str) -> None:
        if self._in_json:
            self.json += data
            self._in_json = False


def data_of(page: Path) -> Any:
    return json.loads(Elements(page.read_text(encoding="utf-8")).json)


def test_the_overview_lists_every_episode(site: Path) -> None:
    data = data_of(site / "index.html")
    assert [e["episode"] for e in data["episodes"]] == [
        "cut", "night 0/episode0", "night 0/episode1", "night 1/episode2",
    ]  # fmt: skip
    for episode in data["episodes"]:
        assert (site / "episodes" / f"{episode['slug']}.html").exists()
    assert data["unreadable"]
    causes = {cause for e in data["episodes"] for cause in (*e["causes"], *e["action_causes"])}
    assert causes
    assert causes <= data["changes"].keys()


def test_an_episodes_page_has_its_steps_and_their_pictures(site: Path) -> None:
    data = data_of(site / "episodes" / f"{slug('night 0/episode0')}.html")
    assert [step["kind"] for step in data["steps"]] == ["grasp", "push", "grasp"]
    assert [step["success"] for step in data["steps"]] == ["yes", "no", "unknown"]
    assert data["steps"][1]["refusals"][0]["cause"] == "refused plan"
    folder = site / "episodes" / data["folder"]
    for step, q_maps in zip(data["steps"], data["q_maps"], strict=True):
        looks = data["looks"][step["look"]]
        assert (folder / looks["camera"]).read_bytes().startswith(b"\xff\xd8\xff")
        for file in (looks["map"], q_maps["push"], q_maps["grasp"]):
            assert (folder / file).read_bytes().startswith(b"\x89PNG")
        assert len(step["path"]["t"]) == 6


def test_a_log_without_previews_has_camera_pictures_all_the_same(tmp_path: Path) -> None:
    """The first logs had none."""
    images = write_images(read_episode(FIRST_SCHEMA), tmp_path)
    assert len(images.looks) == 3
    for look in images.looks.values():
        picture = cv2.imread(str(tmp_path / look["camera"]))
        assert picture is not None
        assert picture.shape == (12, 16, 3)


def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        addresses = set(re.findall(r"https?://[^\s\"'<]+", text))
        assert addresses <= {"http://www.w3.org/2000/svg"}
        assert "default-src 'none'" in text


def test_text_from_a_log_cannot_become_markup(site: Path) -> None:
    page = site / "index.html"
    names = Elements(page.read_text(encoding="utf-8")).names
    assert names.count("script") == 2
    assert "b" not in names
    assert data_of(page)["episodes"][2]["policy"] == HOSTILE


def test_script_data_holds_no_markup() -> None:
    text = as_script_data({"x": HOSTILE, "y": "<!--", "z": "\u2028"})
    assert "<" not in text
    assert "\u2028" not in text
    assert json.loads(text)["x"] == HOSTILE


@pytest.mark.parametrize(("one", "other"), [("a/b", "a_b"), ("a b", "a/b"), ("..", "a/..")])
def test_slugs_differ_and_stay_in_the_folder(one: str, other: str) -> None:
    assert slug(one) != slug(other)
    assert "/" not in slug(one) + slug(other)


@contextmanager
def served(server: ThreadingHTTPServer) -> Iterator[str]:
    """Its address."""
    with server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


def test_served_on_loopback_only(site: Path) -> None:
    server = open_server(site, 0)
    with served(server) as address:
        with urllib.request.urlopen(f"{address}/index.html") as answer:
            assert b"application/json" in answer.read()
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(f"{address}/../logs/none.mcap")
        elsewhere = {"Host": "evil.example"}  # a name that was made to lead here
        rebound = urllib.request.Request(f"{address}/", headers=elsewhere)
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(rebound)
        assert server.server_address[0] == "127.0.0.1"


# --- in a browser -----------------------------------------------------------------------------

WALK = Path(__file__).with_name("walk.html")  # clicks, and tells the address in its query
DEADLINE = 300  # s; a walk takes two


class Listener(BaseHTTPRequestHandler):
    told: queue.Queue[bytes] = queue.Queue()

    def do_POST(self) -> None:
        self.told.put(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed: apt install chromium")
def test_a_walk_through_the_pages(site: Path, tmp_path: Path) -> None:
    shutil.copy(WALK, site)
    listener = ThreadingHTTPServer(("127.0.0.1", 0), Listener)
    with served(open_server(site, 0)) as pages, served(listener) as ear:
        browser = subprocess.Popen(
            [
                str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu",
                "--disable-background-networking", f"--user-data-dir={tmp_path}",
                f"{pages}/walk.html?{ear}",
            ],
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            said = dict(json.loads(Listener.told.get(timeout=DEADLINE)))
        finally:
            browser.terminate()
            browser.wait()
    evidence = said.pop("evidence", "")
    assert said == {
        "rows": 4, "filtered": 1, "deep link": True, "cleared": 4, "by cause": True,
        "step": "Step 1 of 3: grasp", "right": "Step 2 of 3: push", "hash": "#step-2",
        "clicked": "Step 3 of 3: grasp", "failure": "Step 2 of 3: push", "charts": 3,
        "pictures": 5, "later": "night 0/episode1", "title": False, "back": 4,
    }  # fmt: skip
    assert "finger on object" in evidence
