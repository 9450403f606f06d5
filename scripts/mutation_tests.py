"""Runs the tests of both rooms against one change after the other, in a process that has collected them once: each
change is put into the functions of a fork of it, and the tests that reach the changed lines run, the quickest first.
What the changes are is `mutation_changes.py`, which are tried and counted `mutation.py`.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.abc
import importlib.util
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from inspect import unwrap
from pathlib import Path
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any

from mutation_changes import ROOMS, ROOT, Mutant, changed_code, statement_lines

TESTS = tuple(f"tests/{room.split('/')[1]}" for room in ROOMS)
SLOW = ("tests/report/test_made_up_cohorts.py",)  # counts over hundreds of studies; `--slow` runs it, too
NOT_DONE = "elsewhere"  # what cannot be changed in functions that are there: defaults, constants of modules
IMPORTED_ANEW = ("desirepath.analysis", "desirepath.report", "desirepath_experiments")


@dataclass(frozen=True)
class Outcome:
    """by: the test that noticed, or what else became of the run; empty where the change survived."""

    mutant: Mutant
    survives: bool
    by: str
    seconds: float


@dataclass
class Reach:
    """Which lines of both rooms a test file's tests run, and how long they take."""

    always: set[tuple[str, int]] = field(default_factory=set)  # while the file is imported
    lines: dict[str, set[tuple[str, int]]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


def test_files() -> list[str]:
    """Of both rooms, in their order."""
    return sorted(p.relative_to(ROOT).as_posix() for folder in TESTS for p in (ROOT / folder).glob("test_*.py"))


def function_of(code: CodeType, changed: CodeType) -> list[tuple[tuple[str, ...], CodeType]] | None:
    """Names and new code of the functions that differ; None where a module or a class does so outside of them."""
    if code == changed:
        return []
    own, new = ([c for c in one.co_consts if not isinstance(c, CodeType)] for one in (code, changed))
    if (code.co_code, code.co_names) != (changed.co_code, changed.co_names) or repr(own) != repr(new):
        return None
    found: list[tuple[tuple[str, ...], CodeType]] = []
    inner = [[c for c in one.co_consts if isinstance(c, CodeType)] for one in (code, changed)]
    if len(inner[0]) != len(inner[1]):
        return None
    for old, one in zip(*inner, strict=True):
        if old == one:
            continue
        if old.co_flags & 0x2:  # with fast locals: a function; a class has none
            found.append(((old.co_name,), one))
            continue
        below = function_of(old, one)
        if below is None:
            return None
        found += [((old.co_name, *names), body) for names, body in below]
    return found


def put_in(mutant: Mutant, module: ModuleType) -> bool:
    """Gives the functions of an imported module the changed code; False where that is not all that changes."""
    found = function_of(*changed_code(mutant))
    if not found:
        return False
    for names, code in found:
        holder: Any = module
        for name in names[:-1]:
            holder = vars(holder).get(name)
            if not isinstance(holder, type):
                return False
        one = vars(holder).get(names[-1])
        if isinstance(one, property):
            one = one.fget
        elif isinstance(one, cached_property):
            one = one.func
        elif isinstance(one, classmethod | staticmethod):
            one = one.__func__
        one = unwrap(one) if callable(one) else one
        if not isinstance(one, FunctionType) or one.__code__.co_firstlineno != code.co_firstlineno:
            return False
        one.__code__ = code
    return True


def forget() -> None:
    """What functions of both rooms remember of calls."""
    for name in [n for n in sys.modules if n.startswith(IMPORTED_ANEW)]:
        for one in list(vars(sys.modules[name]).values()):
            if hasattr(one, "cache_clear"):
                one.cache_clear()


def waited(child: int, limit_s: float) -> int:
    """Exit status of a fork; one that takes longer is ended (-9). Time in which this process was stopped, too, does
    not count."""
    left, looked = limit_s, time.monotonic()
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if left < 0:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return -signal.SIGKILL
        time.sleep(0.01)
        left -= min(1.0, time.monotonic() - looked)
        looked = time.monotonic()


def processor_limit(seconds: float) -> None:
    """Ends this process after so long at work: other load does not end it."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 10))


class _Warm:
    """A pytest plugin whose test loop is the loop over changes."""

    def __init__(self, todo: list[Mutant], *, slow: bool, limit_s: float, told: Callable[[Outcome], bool]) -> None:
        self.todo, self.slow, self.limit_s, self.told = todo, slow, limit_s, told
        self.items: dict[str, list[Any]] = {}
        self.lines: set[tuple[str, int]] | None = None
        self.fixture_lines: dict[str, set[tuple[str, int]]] = {}
        self.said: Callable[[str], None] | None = None

    def pytest_runtestloop(self, session: Any) -> bool:
        if session.testsfailed:
            raise session.Failed("the tests cannot be collected")
        for item in session.items:
            self.items.setdefault(item.nodeid.split("::")[0], []).append(item)
        self.reach = {file: self.reached(file) for file in self.items}
        for mutant in self.todo:
            if not self.told(self.tried(mutant)):
                break
        return True

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed and self.said is not None:
            self.said(report.nodeid)

    # --- which lines a test reaches

    def reached(self, file: str) -> Reach:
        """Measured once for this state of both rooms and this test file."""
        sources = [*(p for room in ROOMS for p in sorted((ROOT / room).glob("*.py"))), ROOT / file]
        sources += [p for folder in TESTS for p in sorted((ROOT / folder).glob("*.py")) if "test_" not in p.name]
        key = hashlib.sha256(b"".join(hashlib.sha256(p.read_bytes()).digest() for p in sources)).hexdigest()[:16]
        kept = Path(tempfile.gettempdir()) / f"desirepath-reach-{Path(file).stem}-{key}.json"
        if not kept.is_file():
            child = os.fork()
            if child == 0:
                self._trace(file, kept)
            if (code := waited(child, 1800)) != 0:
                sys.exit(f"{file}: the tests fail as they are ({code}): nothing can be learned from changes")
        found = json.loads(kept.read_text(encoding="utf-8"))
        lines = {name: {(f, n) for f, n in own} for name, own in found["lines"].items()}
        return Reach({(f, n) for f, n in found["always"]}, lines, found["seconds"])

    def _trace(self, file: str, kept: Path) -> None:
        code = 1
        try:
            found = Reach()
            names = {str(p): p.relative_to(ROOT).as_posix() for room in ROOMS for p in (ROOT / room).glob("*.py")}

            def local(frame: FrameType, event: str, _: object) -> Any:
                if event == "line" and self.lines is not None:
                    self.lines.add((names[frame.f_code.co_filename], frame.f_lineno))
                return local

            def trace(frame: FrameType, event: str, _: object) -> Any:
                return local if frame.f_code.co_filename in names else None

            failed = list[str]()
            self.said = failed.append
            self.lines = found.always
            sys.settrace(trace)
            there = {name: module for name, module in sys.modules.items() if name.startswith(IMPORTED_ANEW)}
            for name in there:
                del sys.modules[name]
            spec = importlib.util.spec_from_file_location("reached_tests", ROOT / file)
            if spec is None or spec.loader is None:
                return
            spec.loader.exec_module(importlib.util.module_from_spec(spec))
            sys.settrace(None)
            for name, module in there.items():  # the tests hold on to these
                sys.modules[name] = module
                setattr(sys.modules[name.rpartition(".")[0]], name.rpartition(".")[2], module)
            items = self.items[file]
            for item, following in zip(items, [*items[1:], None], strict=True):
                forget()
                self.lines = found.lines.setdefault(item.nodeid, set())
                sys.settrace(trace)
                begun = time.process_time()
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                found.seconds[item.nodeid] = time.process_time() - begun
                sys.settrace(None)
                for name in item.fixturenames:  # one of a module ran with the first test that needed it
                    found.lines[item.nodeid] |= self.fixture_lines.get(name, set())
            if not failed:
                told = {"always": sorted(found.always), "seconds": found.seconds}
                told["lines"] = {name: sorted(own) for name, own in found.lines.items()}
                kept.with_suffix(f".{os.getpid()}").write_text(json.dumps(told), encoding="utf-8")
                kept.with_suffix(f".{os.getpid()}").rename(kept)
                code = 0
            else:
                print(*failed, sep="\n", file=sys.stderr)
        finally:
            os._exit(code)

    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> None:
        if self.lines is not None:  # from here on the fixture's own; what the test runs is added to it as well
            self.fixture_lines.setdefault(fixturedef.argname, self.lines)

    # --- one change

    def order(self, mutant: Mutant) -> list[Any]:
        """The tests that reach the change, the quickest first, but before all others those named after the file."""
        at = {(mutant.file, line) for line in statement_lines(mutant)}
        bears_name = f"test_{Path(mutant.file).name}"
        near = {
            item: (self.reach[file].seconds[item.nodeid] * (0.1 if file.endswith(bears_name) else 1.0), file)
            for file, items in self.items.items()
            for item in items
            if self.reach[file].lines[item.nodeid] & at
        }
        quick = {item for item, (_, file) in near.items() if file not in SLOW or file.endswith(bears_name)}
        return sorted(quick if quick and not self.slow else near, key=lambda item: near[item])

    def tried(self, mutant: Mutant) -> Outcome:
        begun = time.monotonic()
        at = {(mutant.file, line) for line in statement_lines(mutant)}
        name = mutant.file.removesuffix(".py").replace("/", ".")
        if any(own.always & at for own in self.reach.values()) or name not in sys.modules:
            return Outcome(mutant, True, NOT_DONE, 0.0)
        items = self.order(mutant)
        if not items:
            return Outcome(mutant, True, "", time.monotonic() - begun)
        expected = sum(self.reach[item.nodeid.split("::")[0]].seconds[item.nodeid] for item in items)
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            self._try(mutant, items, write, 15 + 8 * expected)
        os.close(write)
        code = waited(child, self.limit_s + 20 * expected)
        with os.fdopen(read) as pipe:
            said = pipe.read()
        if said == NOT_DONE:
            return Outcome(mutant, True, NOT_DONE, 0.0)
        by = said or ("" if code == 0 else f"ended with {code}: took too long or crashed")
        return Outcome(mutant, code == 0, by, time.monotonic() - begun)

    def _try(self, mutant: Mutant, items: list[Any], write: int, limit_s: float) -> None:
        def say(what: str) -> None:
            os.write(write, what.encode())
            os._exit(1)

        try:
            with contextlib.suppress(ValueError):
                processor_limit(limit_s)
            if not put_in(mutant, sys.modules[mutant.file.removesuffix(".py").replace("/", ".")]):
                say(NOT_DONE)
            forget()
            self.said = say
            for item, following in zip(items, [*items[1:], None], strict=True):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            os._exit(0)
        finally:
            os._exit(1)


class _Imported(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the changed module in place of the one on disk."""

    def __init__(self, mutant: Mutant) -> None:
        self.name = mutant.file.removesuffix(".py").replace("/", ".")
        self.path = ROOT / mutant.file
        self.code = changed_code(mutant)[1]

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> Any:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(self.path))

    def create_module(self, spec: object) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self.path)
        exec(self.code, module.__dict__)  # noqa: S102


class _Stop:
    """Says which test failed; pytest's own `-x` ends the run."""

    def __init__(self, write: int) -> None:
        self.write = write

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            os.write(self.write, f"{report.nodeid}\n".encode())

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            os.write(self.write, f"{report.nodeid}\n".encode())


def _pytest(arguments: list[str], plugin: object) -> int:
    import pytest

    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    common = ["-q", "-p", "no:cacheprovider", "-p", "no:timeout", "-s", "-W", "ignore"]
    return int(pytest.main([*common, *arguments], plugins=[plugin]))


def tried_warm(todo: list[Mutant], *, slow: bool, limit_s: float, told: Callable[[Outcome], bool]) -> None:
    """Tries changes inside functions in forks of one process; of the others tells `NOT_DONE`. Does not return to a
    state in which tests could be imported anew: to be called in a fork."""
    import numba

    numba.config.DISABLE_JIT = True  # of what is imported from now on: compiled code lies in a cache, unchanged
    if (code := _pytest(test_files(), _Warm(todo, slow=slow, limit_s=limit_s, told=told))) not in (0, 5):
        sys.exit(f"pytest ended with {code}")  # 5: it ran no test itself, its forks did


def tried_imported(mutant: Mutant, *, slow: bool, limit_s: float) -> Outcome:
    """Tries one change with the module and all that import it imported anew."""
    begun = time.monotonic()
    nearest = [file for file in test_files() if file.endswith(f"test_{Path(mutant.file).name}")]
    rest = [file for file in test_files() if file not in nearest and (slow or file not in SLOW)]
    if mutant.file.startswith("backend/desirepath/report"):  # no test of analysis imports a report
        rest = sorted((one for one in rest if one.startswith("tests/report")), key=lambda one: "known" not in one)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        _import_and_run(mutant, [*nearest, *rest], write)
    os.close(write)
    code = waited(child, limit_s + 600)
    with os.fdopen(read) as pipe:
        said = pipe.read().strip()
    by = said or ("" if code == 0 else f"ended with {code}: took too long or crashed")
    return Outcome(mutant, code == 0, by, time.monotonic() - begun)


def _import_and_run(mutant: Mutant, files: list[str], write: int) -> None:
    import numba

    numba.config.DISABLE_JIT = True
    code = 1
    try:
        processor_limit(600)
        for name in [n for n in sys.modules if n.startswith(IMPORTED_ANEW)]:
            del sys.modules[name]
        sys.meta_path.insert(0, _Imported(mutant))
        code = _pytest(["-x", *files], _Stop(write))
    finally:
        os._exit(code)
