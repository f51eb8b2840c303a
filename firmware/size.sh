#!/usr/bin/env bash
# Flash and RAM an ELF takes of an ATmega2560: 253,952 bytes of flash beside the bootloader, 8,192 of RAM.
set -euo pipefail
read -r text data bss _ < <(avr-size "$1" | tail -1)
awk -v f=$((text + data)) -v r=$((data + bss)) 'BEGIN {
  printf "flash %d of 253952 bytes (%.1f %%), RAM %d of 8192 bytes (%.1f %%)\n", f, 100 * f / 253952, r, 100 * r / 8192 }'
