#!/usr/bin/env bash
# Makes .venv and installs into it: `run` what the programs need, `dev` also what tests and benchmarks need, `env` nothing.
set -euo pipefail
cd "$(dirname "$0")/.."
kind=${1:-run}
venv=.venv

# Says the name of a Python that fits; one that can make environments rather than one that lacks Debian's venv package.
find_python() {
  # 3.12 and 3.11 first: they have a wheel of every library.
  local name fitting=
  for name in python3.12 python3.11 python3.13 python3; do
    command -v "$name" >/dev/null 2>&1 || continue
    "$name" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] < (3, 14))' >/dev/null 2>&1 || continue
    "$name" -c 'import ensurepip, venv' >/dev/null 2>&1 && echo "$name" && return
    fitting=${fitting:-$name}
  done
  [ -n "$fitting" ] && echo "$fitting"
}

has_pip() { [ -x "$venv/bin/python" ] && "$venv/bin/python" -m pip --version >/dev/null 2>&1; }

# A failed attempt leaves nothing: half an environment would be taken for a whole one by the next run.
try_venv() {
  rm -rf "$venv"
  "$1" -m venv "$venv" >/dev/null 2>&1 && has_pip && return
  rm -rf "$venv"
  return 1
}

make_venv() {
  local python package
  python=$(find_python) || {
    echo "setup: needs Python 3.11, 3.12 or 3.13; on Debian: apt-get install python3 python3-venv" >&2
    return 1
  }
  try_venv "$python" && return
  # Debian ships each Python without venv, in a package of its own; only root may add it.
  package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "setup: installing the Debian package $package"
    { apt-get install -y -qq "$package" >/dev/null 2>&1 ||
      { apt-get update -qq && apt-get install -y -qq "$package"; } >/dev/null 2>&1; } &&
      try_venv "$python" && return
  fi
  echo "setup: $python cannot make an environment; run: sudo apt-get install $package" >&2
  return 1
}

has_pip || {
  echo "setup: making $venv"
  make_venv || exit 1
}
[ "$kind" != env ] || exit 0
extras=robot,simulation,station
if [ "$kind" = dev ]; then
  extras+=,dev
  export SENTINEL_PAGE_TOOLS=1 # or `make lint` would install npm's packages a second time
fi
echo "setup: installing $extras (a few minutes the first time)"
"$venv/bin/python" -m pip install --disable-pip-version-check --quiet --upgrade pip
"$venv/bin/python" -m pip install --disable-pip-version-check --quiet --no-compile -c constraints.txt -e ".[$extras]"
# Compiling is half of all work here, and pip does it on one core. Not the libraries' own tests (a third of
# it); and some libraries ship files for other Pythons.
"$venv/bin/python" -m compileall -q -j 0 -x 'site-packages/.*/tests?/' "$venv/lib" >/dev/null 2>&1 || true
touch "$venv/.run"
[ "$kind" = dev ] && touch "$venv/.dev"
exit 0
