"""URScript, as far as uploaded programs need it: text to cooperative threads.

A program is translated line by line into Python generators, of which a control cycle runs each
once: a function that takes time yields until it is done. The translation admits a fixed set of
syntax and no attribute or built-in name, so that a script can call nothing but `builtins`.
Source: Universal Robots, "The URScript Programming Language", 3.15 and 5.11.
"""

from __future__ import annotations

import ast
import keyword
import re
from collections.abc import Callable, Generator, Iterable, Mapping
from inspect import isgeneratorfunction
from typing import Any

Steps = Generator[None, None, Any]

_OWN_KEYWORDS = {"and", "or", "not", "if", "elif", "else", "while", "return", "break", "def"}
_OWN_KEYWORDS |= {"True", "False", "global", "continue", "pass"}
_RENAMED = re.compile(rf"\b({'|'.join(set(keyword.kwlist) - _OWN_KEYWORDS)})\b")
_RUN = re.compile(r"\brun\s+(\w+)\((.*)\)$")

_SYNTAX = (
    *(ast.Module, ast.FunctionDef, ast.arguments, ast.arg, ast.Return, ast.Pass, ast.Global),
    *(ast.Assign, ast.Expr, ast.If, ast.While, ast.Break, ast.Continue, ast.YieldFrom),
    *(ast.Call, ast.keyword, ast.Name, ast.Constant, ast.List, ast.Tuple, ast.Subscript),
    *(ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.expr_context),
    *(ast.operator, ast.unaryop, ast.boolop, ast.cmpop),
)


class ScriptError(Exception):
    """The program cannot be translated, or failed while it ran."""


class Pose(list[float]):
    """p[x, y, z, rx, ry, rz]: what tells a pose from six joints."""


class Thread:
    """A thread of a program; `kill` ends it where it waits."""

    def __init__(self, steps: Steps) -> None:
        self._steps = steps
        self.alive = True

    def step(self) -> None:
        try:
            next(self._steps)
        except StopIteration:
            self.alive = False

    def kill(self) -> None:
        self.alive = False
        self._steps.close()


class Program:
    """A program that runs: `step` it once a control cycle until it is no longer `alive`."""

    def __init__(self, source: str, builtins: Mapping[str, Callable[..., Any]]) -> None:
        """Generator functions among `builtins` take time: the script waits for their end.

        Raises ScriptError.
        """
        self._threads: list[Thread] = []
        waiting = {name for name, function in builtins.items() if isgeneratorfunction(function)}
        name, code = _translate(source, waiting)
        names: dict[str, Any] = {"__builtins__": {}, "run": self._run, "kill": self._kill}
        names |= {"Pose": Pose} | dict(builtins)
        exec(code, names)  # noqa: S102  (only what _SYNTAX admits)
        self.name = name
        self._main = self._run(names[name]())

    @property
    def alive(self) -> bool:
        return self._main.alive

    def step(self) -> None:
        """Run every thread to its next wait. Raises ScriptError; the program is dead then."""
        try:
            for thread in self._threads:  # grows while threads start threads
                if thread.alive and self.alive:
                    thread.step()
        except Exception as error:
            self.kill()
            raise ScriptError(f"{self.name}: {error}") from error
        self._threads = [thread for thread in self._threads if thread.alive]
        if not self.alive:
            self.kill()

    def kill(self) -> None:
        for thread in self._threads:
            thread.kill()

    def _run(self, steps: Steps) -> Thread:
        thread = Thread(steps)
        self._threads.append(thread)
        return thread

    def _kill(self, thread: Thread | int) -> None:
        if isinstance(thread, Thread):  # scripts kill 0 when no thread was started
            thread.kill()


def split_programs(text: str) -> tuple[list[str], str]:
    """Whole `def ... end` programs at the start of what a client has sent, and what is left."""
    found, start, depth = [], 0, 0
    for line in re.finditer(r"[^\n]*\n", text):
        code = _code(line[0])
        depth += _opens(code) - (code == "end")
        if depth == 0:
            program = text[start : line.end()]
            start = line.end()
            if program.strip():
                found.append(program)
    return found, text[start:]


def _code(line: str) -> str:
    """The line without indentation and comment."""
    parts = line.split('"')
    for i in range(0, len(parts), 2):
        if "#" in parts[i]:
            parts = [*parts[:i], parts[i].split("#")[0]]
            break
    return '"'.join(parts).strip()


def _statements(source: str) -> Iterable[str]:
    """One statement each. A value may follow its `=` in the next line, before a statement:
    ur_rtde puts its register offsets behind the comment that follows the `=`."""
    begun = ""
    for line in source.splitlines():
        code = _code(line)
        if begun and code:
            value, _, rest = code.partition(" ")
            yield f"{begun} {value}"
            code = rest.strip()
        begun = code if code.endswith("=") else ""
        if code and not begun:
            yield code


def _opens(code: str) -> bool:
    return re.match(r"(def|thread|if|while)\b", code) is not None


def _translate(source: str, waiting: set[str]) -> tuple[str, Any]:
    """Name of the main function, and compiled Python that defines it."""
    python, names, shared = _to_python(source)
    if not names:
        raise ScriptError("a program starts with `def name():`")
    try:
        tree = ast.parse(python)
        tree = _Rewriter(waiting | set(names), shared).visit(tree)
        for node in ast.walk(tree):
            if not isinstance(node, _SYNTAX) or _is_private(node):
                raise ScriptError(f"{names[0]}: {ast.unparse(node)!r} is no URScript")
        return names[0], compile(ast.fix_missing_locations(tree), names[0], "exec")
    except SyntaxError as error:
        raise ScriptError(f"{names[0]}: {error.msg}: {(error.text or '').strip()!r}") from error


def _is_private(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and node.id.startswith("_")


def _to_python(source: str) -> tuple[str, list[str], set[str]]:
    """Python text, functions in order of definition, and names declared `global`."""
    lines: list[str] = []
    functions: list[str] = []
    shared: set[str] = set()
    depth = 0
    for code in _statements(source):
        if match := re.match(r"(?:def|thread)\s+(\w+)", code):
            functions.append(match[1])
        if match := re.match(r"global\s+(\w+)", code):
            shared.add(match[1])
        is_branch = re.match(r"(elif|else)\b", code) is not None
        if code == "end":
            depth -= 1
        elif code not in ("enter_critical", "exit_critical"):  # threads switch only at waits
            lines.append("    " * (depth - is_branch) + _statement_to_python(code))
        depth += _opens(code)
        if _opens(code) or is_branch:
            lines.append("    " * depth + "pass")
    return "\n".join(lines) + "\n", functions, shared


def _statement_to_python(code: str) -> str:
    parts = code.split('"')
    parts[::2] = [_RENAMED.sub(r"\1_", part) for part in parts[::2]]
    python = _RUN.sub(r"run(\1(\2))", '"'.join(parts))
    python = re.sub(r"^global\s+(\w+\s*=)", r"\1", python)
    python = re.sub(r"^global\s+\w+$", "pass", python)
    python = re.sub(r"^kill\s+(\w+)$", r"kill(\1)", python)
    return re.sub(r"^thread\b", "def", python)


class _Rewriter(ast.NodeTransformer):
    """Pose literals, waits, and the scope of globals."""

    def __init__(self, waiting: Iterable[str], shared: set[str]) -> None:
        self._waiting, self._shared = set(waiting), shared

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        self.generic_visit(node)
        is_pose = isinstance(node.value, ast.Name) and node.value.id == "p"
        if is_pose and isinstance(node.slice, ast.Tuple):
            items = ast.List(node.slice.elts, ast.Load())
            return ast.Call(ast.Name("Pose", ast.Load()), [items], [])
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id == "run":
            return node  # the thread is stepped later, not waited for
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id in self._waiting:
            return ast.YieldFrom(node)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        assigned = {
            target.id
            for statement in _own_statements(node)
            if isinstance(statement, ast.Assign)
            for target in statement.targets
            if isinstance(target, ast.Name)
        }
        outside = sorted(assigned & self._shared - {argument.arg for argument in node.args.args})
        self.generic_visit(node)
        generator = ast.Expr(ast.YieldFrom(ast.Tuple([], ast.Load())))
        scope: list[ast.stmt] = [ast.Global(outside)] if outside else []
        node.body = [*scope, generator, *node.body]
        return node


def _own_statements(function: ast.FunctionDef) -> Iterable[ast.stmt]:
    """Statements of a function, without those of functions defined in it."""
    todo: list[ast.stmt] = list(function.body)
    while todo:
        statement = todo.pop()
        yield statement
        if isinstance(statement, (ast.If, ast.While)):
            todo += statement.body + statement.orelse
