#!/usr/bin/env bash
# Makes .venv and installs into it: `run` what the programs need, `dev` also what tests and benchmarks need.
set -euo pipefail
cd "$(dirname "$0")/.."
kind=${1:-run}
venv=.venv

find_python() {
  # 3.12 and 3.11 first: they have a wheel of every library.
  for name in python3.12 python3.11 python3.13 python3; do
    if command -v "$name" >/dev/null 2>&1 &&
      "$name" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' >/dev/null 2>&1; then
      echo "$name"
      return
    fi
  done
  echo "setup: needs Python 3.11, 3.12 or 3.13; on Debian: apt-get install python3 python3-venv" >&2
  exit 1
}

make_venv() {
  local python=$1
  "$python" -m venv "$venv" >/dev/null 2>&1 && return
  # Debian ships Python without venv; only root may add it.
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "setup: installing the Debian package python3-venv"
    apt-get install -y -qq python3-venv >/dev/null || { apt-get update -qq && apt-get install -y -qq python3-venv >/dev/null; }
    rm -rf "$venv"
    "$python" -m venv "$venv"
  else
    echo "setup: Python lacks venv; run: sudo apt-get install python3-venv" >&2
    exit 1
  fi
}

[ -x "$venv/bin/python" ] || { echo "setup: making $venv"; make_venv "$(find_python)"; }
extras=robot,simulation,station
[ "$kind" = dev ] && extras+=,dev
echo "setup: installing $extras (a few minutes the first time)"
"$venv/bin/python" -m pip install --disable-pip-version-check --quiet --upgrade pip
"$venv/bin/python" -m pip install --disable-pip-version-check --quiet -c constraints.txt -e ".[$extras]"
touch "$venv/.run"
[ "$kind" = dev ] && touch "$venv/.dev"
exit 0
