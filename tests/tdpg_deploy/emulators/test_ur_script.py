"""The URScript subset: what it computes, when its threads run, what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tdpg_deploy.emulators.ur_controller.script import (
    Pose,
    Program,
    ScriptError,
    Steps,
    split_programs,
)


class Host:
    """Functions that scripts of these tests call."""

    def __init__(self) -> None:
        self.said: list[Any] = []

    def say(self, value: Any) -> None:
        self.said.append(value)

    def sync(self) -> Steps:
        yield

    def twice(self, value: float) -> Steps:
        """Takes a cycle."""
        yield
        return 2 * value


def run(body: str, cycles: int = 20) -> list[Any]:
    """What a program says until it ends, or for so many cycles."""
    host = Host()
    functions: dict[str, Callable[..., Any]] = {
        "say": host.say,
        "sync": host.sync,
        "twice": host.twice,
    }
    program = Program(f"def program():\n{body}\nend\n", functions)
    for _ in range(cycles):
        if not program.alive:
            break
        program.step()
    return host.said


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("x = 3\nif x > 2 and not False:\n say(1)\nelse:\n say(2)\nend", [1]),
        ("x = 1\nif x == 2:\n say(1)\nelif x == 1:\n say(2)\nelse:\n say(3)\nend", [2]),
        ("i = 0\nwhile (True):\n i = i + 1\n if i == 3:\n  break\n end\nend\nsay(i)", [3]),
        ("def f(a, b):\n return a * b\nend\nsay(f(2, b=4))", [8]),
        ("say(twice(twice(3)))", [12]),
        ("q = [1, 2]\nq[1] = 5\nsay(q)", [[1, 2 + 3]]),
        ("async = 1 # a keyword elsewhere\nsay(async)", [1]),
        ('say("# no comment") # comment', ["# no comment"]),
        ("global x = # the value follows below\n7    global y = 8\nsay(x + y)", [15]),
        ("if False:\nend\nsay(1)", [1]),
    ],
)
def test_language(body: str, said: list[Any]) -> None:
    assert run(body) == said


def test_pose_literal_differs_from_an_index_of_p() -> None:
    literal, element = run("say(p[1, 2, 3, 0, 0, 0])\np = p[4, 0, 0, 0, 0, 0]\nsay(p[0])")
    assert isinstance(literal, Pose)
    assert literal == [1, 2, 3, 0, 0, 0]
    assert element == 4


def test_functions_share_globals_and_keep_locals() -> None:
    body = """
        global shared = 1
        def change():
            shared = 2
            own = 3
        end
        own = 4
        change()
        say(shared)
        say(own)
    """
    assert run(body) == [2, 4]


def test_threads_run_once_a_cycle_from_the_cycle_they_start_in() -> None:
    body = """
        thread worker():
            while True:
                say("worker")
                sync()
            end
        end
        t = run worker()
        say("started")
        sync()
        say("main")
        kill t
        kill 0
        sync()
        say("end")
    """
    assert run(body.replace("kill 0", "none = 0\nkill none")) == [
        *("started", "worker", "main", "end"),
    ]


def test_program_ends_with_its_main_thread() -> None:
    body = "thread t():\n while True:\n  say(1)\n  sync()\n end\nend\nx = run t()\nsync()"
    assert run(body) == [1]


@pytest.mark.parametrize(
    "body",
    [
        "x = (1).__class__",
        "x = __builtins__",
        "import os",
        "x = lambda: 1",
        "x = [i for i in [1]]",
        "x = 1 +",
    ],
)
def test_what_is_no_urscript_is_refused(body: str) -> None:
    with pytest.raises(ScriptError):
        run(body)


def test_nothing_of_python_is_within_reach() -> None:
    for name in ("open", "eval", "print", "getattr"):
        with pytest.raises(ScriptError, match=name):
            run(f'say({name}("x"))')


def test_error_ends_the_program() -> None:
    host = Host()
    program = Program("def p():\n sync()\n x = 1 / 0\nend\n", {"sync": host.sync})
    program.step()
    with pytest.raises(ScriptError, match="p: division by zero"):
        program.step()
    assert not program.alive


def test_program_without_def_is_refused() -> None:
    with pytest.raises(ScriptError, match="starts with `def"):
        Program("movej([0])\n", {})


def test_programs_are_split_at_their_ends() -> None:
    one = "def a():\n  if True:\n    x = 1 # end\n  end\nend\n"
    two = 'def b():\n  say("if")\nend\n'
    half = "def c():\n  while True:\n"
    assert split_programs(one + "\n" + two + half) == ([one, two], half)
