#!/usr/bin/env bash
# Open3D for the tests and benchmarks of the second registration backend: the library into .venv, and the Debian packages
# it loads. Exit code 0 also where it cannot be had: it says what is missing, and what needs it is skipped by name.
set -euo pipefail
cd "$(dirname "$0")/.."
python=.venv/bin/python
works() { $python -W ignore -c 'import open3d' >/dev/null 2>&1; }
is_installed() { $python -c 'import importlib.util, sys; sys.exit(importlib.util.find_spec("open3d") is None)'; }
# As pyproject.toml has them; `pip install -e .[open3d]` would build the page again.
requirements() {
  $python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["open3d"], sep="\n")'
}

if ! is_installed; then
  echo "Open3D tests need open3d: installing it into .venv (a download of some 110 MB, which pip keeps)"
  mapfile -t wanted < <(requirements)
  $python -m pip install --disable-pip-version-check --quiet --no-compile -c constraints.txt "${wanted[@]}" || {
    echo "Open3D tests are skipped: pip could not install it" >&2
    exit 0
  }
fi
works || scripts/apt-need.sh "Open3D tests" libegl1 libgl1 libusb-1.0-0 libx11-6
