"""An S3-compatible store for tests: moto's server on loopback, with one bucket. Nothing of it outlives the test."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import boto3
from s3fs import S3FileSystem

BUCKET = "lab"
KEYS = {"AWS_ACCESS_KEY_ID": "tests", "AWS_SECRET_ACCESS_KEY": "tests", "AWS_DEFAULT_REGION": "us-east-1"}
PATIENCE_S = 60.0


@dataclass
class S3:
    """A running store. url: of a folder in its bucket; address: where it listens; client: boto3's, to look behind."""

    process: subprocess.Popen[bytes]
    url: str
    address: str
    client: Any

    def kill(self) -> None:
        """It is gone from one moment to the next."""
        self.process.kill()
        self.process.wait()


@contextmanager
def s3_store() -> Iterator[S3]:
    """Start one; what speaks to S3 in this process and its children finds it by the environment, as in a deployment."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address = f"http://127.0.0.1:{port}"
    before = {name: os.environ.get(name) for name in (*KEYS, "AWS_ENDPOINT_URL")}
    os.environ |= KEYS | {"AWS_ENDPOINT_URL": address}
    try:
        _await(port)
        S3FileSystem.clear_instance_cache()  # of another test's store
        client = boto3.client("s3")
        client.create_bucket(Bucket=BUCKET)
        yield S3(process, f"s3://{BUCKET}/desirepath", address, client)
    finally:
        process.kill()
        process.wait()
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        S3FileSystem.clear_instance_cache()


def _await(port: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while True:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return
        assert time.monotonic() < deadline, "moto's server did not start"
        time.sleep(0.05)
