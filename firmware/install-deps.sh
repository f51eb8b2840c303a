#!/usr/bin/env bash
# Debian packages for building the firmware and running it in the emulator. As root it installs what is missing; otherwise it
# prints the one line that does. Exit code 0 also without them: builds say what they lack, tests skip by name.
set -euo pipefail
exec "$(dirname "$0")/../scripts/apt-need.sh" "firmware build and emulator tests" \
  g++ make gcc-avr avr-libc binutils-avr arduino-core-avr libsimavr-dev libelf-dev pkg-config
