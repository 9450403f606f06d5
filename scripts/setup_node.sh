#!/usr/bin/env bash
# `make lint` checks the browser's modules with TypeScript, which needs Node. Versions are pinned in package.json; there is
# no lock file, as one would record where packages were fetched from.
set -euo pipefail
cd "$(dirname "$0")/.."
if ! command -v npm >/dev/null; then
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends nodejs npm >/dev/null
  else
    echo "make lint needs Node and npm. On Debian: sudo apt-get install nodejs npm" >&2
    exit 1
  fi
fi
npm install --no-package-lock --ignore-scripts --no-audit --no-fund --loglevel=error
