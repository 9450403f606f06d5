#!/usr/bin/env bash
# The tests drive Debian's Chromium; nothing is downloaded from anywhere else.
set -euo pipefail
command -v chromium >/dev/null && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -y -qq chromium >/dev/null
else
  echo "The tests need Chromium. On Debian: sudo apt-get install chromium" >&2
  exit 1
fi
