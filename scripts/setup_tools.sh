#!/usr/bin/env bash
# Make .venv-tools: Hugging Face's datasets, TRL and Minari, with which tests open our data sets, and ROS 2, on which they
# drive. An environment of its own, because datasets brings another HTTP library, to which the test client of .venv would
# change, and ROS's wheels start every Python of theirs once more, with LD_LIBRARY_PATH set, for whatever it starts. What
# .venv has (torch, NumPy, pyarrow, ...) is not installed twice: it is found behind the tools' own packages.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=$(realpath .venv)
tools="$(dirname "$venv")/.venv-tools"
"$venv/bin/python" -m venv --clear --without-pip "$tools"
site=$("$tools/bin/python" -c 'import sysconfig; print(sysconfig.get_paths()["purelib"])')
behind=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_paths()["purelib"])')
"$venv/bin/python" -c 'import os, sys; print(os.path.relpath(*sys.argv[1:]))' "$behind" "$site" > "$site/behind.pth"
scripts/install_locked.sh "$tools/bin/python" scripts/tools.lock
