"""The steps of the Dockerfile carried out in a folder, by chroot instead of in a container: how far do they go?

The folder's first layer comes of `debootstrap`, from wherever this machine's apt gets its packages. What cannot be the
same without containers stands in `DIFFERENT`. What compose would start of such an image is `composed.py`'s.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import re
import shlex
import shutil
import signal
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from desirepath.cli.loopback import free_port_pair
from desirepath_experiments.image_surroundings import TRUSTED, certificates, passed_on, places_of_packages, sites_of_apt

ROOT = Path(__file__).resolve().parents[2]
DIFFERENT = (
    "the first layer is debootstrap's with Debian's own Python, not the image that FROM names",
    "steps see this machine's network, its certificates, pip's settings and the folders of packages that these name",
    "no layers: a step that failed leaves what it had done, and the next one goes on from there",
)
FIRST_LAYER = ("python3.11", "python3.11-venv", "python3-pip", "python-is-python3", "ca-certificates")
USUAL_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
STEP_PATIENCE_S = 1_800.0
START_PATIENCE_S, LOOK_S = 120.0, 0.2
SAID = 1_200  # letters of a failed step's output that are told


class ImageError(RuntimeError):
    """The folder cannot be made, or the Dockerfile has an instruction that is not known here."""


@dataclass(frozen=True)
class Step:
    """One instruction of a Dockerfile. line: where it begins."""

    instruction: str
    words: str
    line: int

    def __str__(self) -> str:
        return f"{self.instruction} {' '.join(self.words.split())}"


def steps_of(dockerfile: str) -> list[Step]:
    """The instructions in their order; comments are left out, lines that go on are put together."""
    steps: list[Step] = []
    held, begun_at = "", 0
    for number, line in enumerate(dockerfile.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        begun_at = begun_at or number
        if line.endswith("\\"):
            held += line[:-1]  # without the line's end, as Docker does: a shell's line may not begin with &&
            continue
        instruction, _, words = (held + line).strip().partition(" ")
        steps.append(Step(instruction.upper(), words.strip(), begun_at))
        held, begun_at = "", 0
    return steps


@dataclass
class Image:
    """A folder that becomes what the Dockerfile makes. environment, user, folder: as the steps so far have set them."""

    root: Path
    source: Path = ROOT
    environment: dict[str, str] = field(default_factory=dict)
    arguments: dict[str, str] = field(default_factory=dict)
    user: str = "root"
    folder: PurePosixPath = field(default_factory=lambda: PurePosixPath("/"))
    command: list[str] = field(default_factory=list)

    def take(self, step: Step) -> str:
        """Carry a step out. Returns what is to be said of it, empty where it is nothing; raises ImageError, and
        CalledProcessError for a command that failed."""
        match step.instruction:
            case "FROM":
                return self._begin(step.words)
            case "ENV":
                self.environment |= self._pairs(step.words)
            case "ARG":
                name, _, value = step.words.partition("=")
                self.arguments[name] = os.environ.get(name, value)
            case "WORKDIR":
                self.folder /= step.words
                (self.root / self.folder.relative_to("/")).mkdir(parents=True, exist_ok=True)
            case "USER":
                self.user = step.words
            case "COPY":
                return self._copy(step.words)
            case "RUN":
                self.run(step.words)
            case "CMD":
                self.command = [word.strip("\"' ") for word in step.words.strip("[]").split(",")]
            case "VOLUME" | "EXPOSE":
                return "says something to whoever starts the image"
            case _:
                raise ImageError(f"line {step.line}: {step.instruction} is not known here")
        return ""

    def run(self, command: str) -> subprocess.CompletedProcess[str]:
        """A shell command inside, with user, folder and environment as the steps so far have set them. Raises
        CalledProcessError."""
        entering, environment = self._entered(command)
        return subprocess.run(
            entering,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=True,
            timeout=STEP_PATIENCE_S,
        )

    def says(self) -> dict[str, Any]:
        """What CMD's program says of itself, and how much room the folder takes. Returns {"said", "megabytes"}."""
        try:
            said = self.run(shlex.join([self.command[0], "--help"])).stdout
        except subprocess.CalledProcessError as problem:
            said = f"failed: {str(problem.output)[-SAID:]}"
        used = subprocess.run(["du", "-sxm", str(self.root)], stdout=subprocess.PIPE, text=True, check=False)
        words = [line.strip() for line in said.splitlines() if line.strip()]
        return {"said": " / ".join(words[:2]), "megabytes": int(used.stdout.split()[0])}

    def serves(self) -> dict[str, Any]:
        """Start what CMD says, on loopback, until its health check's address answers. Returns {"command", "answered",
        "seconds", "said": the end of its output where it did not}."""
        port = free_port_pair()
        settings = {"DESIREPATH_HOST": "127.0.0.1", "DESIREPATH_PORT": str(port), "DESIREPATH_WORKER": "false"}
        entering, environment = self._entered(shlex.join(self.command))
        log, began, answered = self.root / "tmp" / "served.log", time.monotonic(), False
        with log.open("wb") as out:
            process = subprocess.Popen(
                entering,
                env=environment | settings,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                start_new_session=True,
            )
        try:
            while not answered and process.poll() is None and time.monotonic() - began < START_PATIENCE_S:
                with contextlib.suppress(OSError):
                    answered = urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=2).status == 200
                time.sleep(LOOK_S)
        finally:
            seconds = time.monotonic() - began
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(15)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        said = "" if answered else log.read_text(encoding="utf-8", errors="replace")[-SAID:]
        return {"command": shlex.join(self.command), "answered": answered, "seconds": round(seconds, 1), "said": said}

    def _entered(self, command: str) -> tuple[list[str], dict[str, str]]:
        """The command line and environment of a shell command inside. It has a mount namespace of its own: whatever
        becomes of it, nothing stays mounted."""
        said = {name: value for name, value in self.arguments.items() if value} if self.user == "root" else {}
        plain = {"PATH": USUAL_PATH, "DEBIAN_FRONTEND": "noninteractive"}
        home = "/root" if self.user == "root" else f"/home/{self.user}"
        whole = passed_on() | plain | {"HOME": home} | said | self.environment
        expanded = {name: self._expanded(value, plain) for name, value in whole.items()}
        entering = ["chroot", f"--userspec={self.user}:{self.user}", str(self.root)]
        inside = f"cd {shlex.quote(str(self.folder))} && {command}"
        script = " && ".join([*self._mounts(), shlex.join(["exec", *entering, "sh", "-c", inside])])
        return ["unshare", "--mount", "--propagation", "private", "sh", "-c", script], expanded

    def _expanded(self, value: str, plain: Mapping[str, str]) -> str:
        return re.sub(r"\$\{?(\w+)\}?", lambda found: plain.get(found[1], ""), value) if "$" in value else value

    def _pairs(self, words: str) -> dict[str, str]:
        return dict(word.partition("=")[::2] for word in shlex.split(words))

    def _mounts(self) -> Iterator[str]:
        """What a step sees of this machine. No step can write to what is somebody's file."""
        yield from (self._mount("rbind", place, place) for place in (Path("/proc"), Path("/dev")))
        yield from (self._mount("bind,ro", place, place) for place in places_of_packages())
        yield from (self._mount("bind,ro", place, TRUSTED / name) for name, place in certificates().items())

    def _mount(self, how: str, place: Path, at: Path) -> str:
        inside = self.root / at.relative_to("/")
        if place.is_dir():
            inside.mkdir(parents=True, exist_ok=True)
        else:
            inside.parent.mkdir(parents=True, exist_ok=True)
            inside.touch()
        return shlex.join(["mount", "-o", how, str(place.resolve()), str(inside)])

    def _begin(self, image: str) -> str:
        """The first layer, of the Debian that the image's name ends with."""
        if shutil.which("debootstrap") is None or shutil.which("unshare") is None or os.geteuid() != 0:
            raise ImageError("this needs root, debootstrap (Debian's package of that name) and unshare (util-linux)")
        suite = image.rpartition("-")[2]
        site = next((one for one, of in sites_of_apt() if of == suite), None)
        if site is None:
            raise ImageError(f"FROM {image}: this machine's apt has no packages of Debian {suite!r}")
        making = ["debootstrap", "--variant=minbase", f"--include={','.join(FIRST_LAYER)}", suite, str(self.root), site]
        subprocess.run(making, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True)
        self._take_apt()
        return f"debootstrap of {suite} with Debian's {self.run('python3 --version').stdout.strip()}"

    def _take_apt(self) -> None:
        """The folder's apt asks where this machine's does."""
        inside = self.root / "etc/apt"
        (inside / "sources.list").write_text("", encoding="utf-8")
        wanted = {site for site, _ in sites_of_apt()}
        for file in Path("/etc/apt/sources.list.d").glob("*.sources"):
            if any(site.rstrip("/") in file.read_text(encoding="utf-8") for site in wanted):
                shutil.copy(file, inside / "sources.list.d" / file.name)
        said = subprocess.run(["apt-config", "dump", "Acquire"], capture_output=True, text=True, check=True).stdout
        proxies = [line for line in said.splitlines() if "::Proxy" in line]
        trusted = [f'Acquire::https::CAInfo "{TRUSTED / name}";' for name in list(certificates())[:1]]
        (inside / "apt.conf.d" / "80-this-machine").write_text("\n".join([*proxies, *trusted, ""]), encoding="utf-8")
        shutil.copy("/etc/resolv.conf", self.root / "etc/resolv.conf")

    def _copy(self, words: str) -> str:
        """What git knows of these places, without what `.dockerignore` names."""
        *places, target = words.split()
        into = self.root / (self.folder / target).relative_to("/")
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--", *places], cwd=self.source, capture_output=True, text=True, check=True
        ).stdout
        ignored = (self.source / ".dockerignore").read_text(encoding="utf-8").split()
        files = [Path(one) for one in listed.split("\0") if one and not _is_ignored(one, ignored)]
        if not files:
            raise ImageError(f"COPY {words}: nothing of it is there")
        for file in files:
            # A folder's contents go into the target, a file goes under its own name.
            of = next(Path(place) for place in places if Path(place) == file or Path(place) in file.parents)
            place = into / file.name if of == file else into / file.relative_to(of)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(self.source / file, place)
        return f"{len(files)} files"


def build_here(
    root: Path, *, source: Path = ROOT, tell: Callable[[str], None] = lambda words: None
) -> tuple[Image, dict[str, Any]]:
    """Carry out all steps of `source`'s Dockerfile in the folder `root`, which must be empty.

    Returns the image and {"different_from_containers", "steps": per step {"line", "step", "seconds", "ended": "well" or
    "failed", "said"}, "went": how many of how many ended well, "all_well"}. A step that fails stops nobody: the end of
    its output is told and the next one begins. Raises ImageError.
    """
    if root.exists() and any(root.iterdir()):
        raise ImageError(f"{root}: is not empty")
    image = Image(root, source)
    carried_out: list[dict[str, Any]] = []
    for step in steps_of((source / "Dockerfile").read_text(encoding="utf-8")):
        tell(f"line {step.line}: {str(step)[:100]}")
        began = time.monotonic()
        ended = "well"
        try:
            said = image.take(step)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as problem:
            if step.instruction == "FROM":
                raise ImageError(f"{step}: {str(problem.output)[-SAID:]}") from problem
            ended, said = "failed", str(problem.output)[-SAID:]
        carried_out.append(
            {
                "line": step.line,
                "step": str(step)[:160],
                "seconds": round(time.monotonic() - began, 1),
                "ended": ended,
                "said": said,
            }
        )
        if ended == "failed":
            tell(f"failed: {said}")
    well = sum(one["ended"] == "well" for one in carried_out)
    return image, {
        "different_from_containers": DIFFERENT,
        "steps": carried_out,
        "went": f"{well} of {len(carried_out)} steps",
        "all_well": well == len(carried_out),
    }


def _is_ignored(path: str, patterns: list[str]) -> bool:
    parts = PurePosixPath(path).parts
    return any(
        fnmatch.fnmatch(part, pattern.removeprefix("**/")) if pattern.startswith("**/") else parts[0] == pattern
        for pattern in patterns
        for part in parts
    )
