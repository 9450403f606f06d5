"""An operating system's error as a sentence for whoever caused it."""

from __future__ import annotations

import errno

ADVICE = {
    errno.EACCES: "choose a place that this user may read and write",
    errno.EPERM: "choose a place that this user may read and write",
    errno.EROFS: "choose a place that can be written",
    errno.ENOSPC: "make room there, or choose another disk",
    errno.EDQUOT: "make room there, or choose another disk",
    errno.ENOENT: "check the path",
    errno.ENOTDIR: "a part of this path is a file; choose another one",
    errno.EISDIR: "it is a folder; name a file",
    errno.EEXIST: "it is there already; choose another one",
    errno.ENAMETOOLONG: "choose a shorter one",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
}


def in_words(problem: Exception) -> str:
    """`/root/out: permission denied; choose ...` instead of `[Errno 13] ...`; any other error as it says itself."""
    if not isinstance(problem, OSError) or problem.errno is None or not problem.strerror:
        return str(problem)
    reason = problem.strerror[:1].lower() + problem.strerror[1:]
    where = f"{problem.filename}: " if problem.filename is not None else ""
    advice = ADVICE.get(problem.errno)
    return f"{where}{reason}{f'; {advice}' if advice else ''}"
