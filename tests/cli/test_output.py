"""How commands speak to people and to programs."""

from __future__ import annotations

import io
import json
import logging
import sys

import pytest
import structlog
import typer

from desirepath.cli.output import log_to_stderr, plain_errors, say

JOBS = {"jobs": [{"job": "a" * 32, "state": "[failed]", "progress": 0.123456}, {"job": "b" * 32, "state": "queued"}]}


def test_a_list_is_a_table_whose_ids_stay_whole(capsys):
    say(JOBS, as_json=False)
    head, first, second = capsys.readouterr().out.splitlines()
    assert head.split() == ["job", "state", "progress"]
    assert first.split() == ["a" * 32, "[failed]", "0.1235"]
    assert second.split() == ["b" * 32, "queued", "–"]
    say({"jobs": []}, as_json=False)
    assert capsys.readouterr().out.split() == ["jobs", "none"]


def test_json_is_one_object_with_everything(capsys):
    say(JOBS, as_json=True)
    assert json.loads(capsys.readouterr().out) == JOBS


def test_a_question_that_was_not_confirmed_says_that_nothing_was_done(capsys):
    @plain_errors
    def erase(as_json: bool = False) -> None:
        raise typer.Abort

    with pytest.raises(typer.Abort):
        erase(as_json=True)
    assert "nothing was done" in json.loads(capsys.readouterr().out)["error"]


def test_what_is_logged_goes_to_the_stream_that_stands_now(monkeypatch):
    earlier, now = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stderr", earlier)
    log_to_stderr()
    earlier.close()
    monkeypatch.setattr(sys, "stderr", now)
    structlog.get_logger().info("still heard")
    assert "still heard" in now.getvalue()
    log_to_stderr(logging.WARNING)
    structlog.get_logger().info("worker ready")
    structlog.get_logger().warning("no disk")
    log_to_stderr()
    assert "worker ready" not in now.getvalue()
    assert "no disk" in now.getvalue()


@pytest.mark.parametrize(
    ("use", "said"),
    [
        (lambda folder: (folder / "nowhere" / "x").read_bytes(), "x: no such file or directory; check the path"),
        (lambda folder: (folder / "file" / "x").mkdir(), "x: not a directory; a part of this path is a file"),
        (lambda folder: folder.read_bytes(), ": is a directory; it is a folder; name a file"),
        (lambda folder: (folder / ("x" * 300)).touch(), "x: file name too long; choose a shorter one"),
    ],
)
def test_an_error_of_the_system_names_the_path_and_what_would_work(use, said, tmp_path, capsys):
    (tmp_path / "file").touch()

    @plain_errors
    def export(as_json: bool = False) -> None:
        use(tmp_path)

    with pytest.raises(typer.Exit):
        export(as_json=True)
    error = json.loads(capsys.readouterr().out)["error"]
    assert "Errno" not in error
    assert error.startswith(str(tmp_path))
    assert said in error
