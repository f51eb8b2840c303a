#!/usr/bin/env bash
# Installs robot-server on a Raspberry Pi (Pi OS bookworm or trixie) and starts it at every boot. Run it again to update.
#   sudo robot/install.sh [--no-service]
# What it changes: Debian packages, the serial port's name (udev), a service (systemd), the hardware watchdog, /opt/sentinel.
set -euo pipefail
here=$(cd "$(dirname "$0")/.." && pwd)
target=/opt/sentinel
state=/var/lib/sentinel  # key, certificate and tokens
user=sentinel
service=yes
[ "${1:-}" = --no-service ] && service=no

[ "$(id -u)" = 0 ] || { echo "install: run: sudo robot/install.sh" >&2; exit 1; }
. /etc/os-release
case "${VERSION_CODENAME:-}" in
  bookworm | trixie) ;;
  *) echo "install: made for Pi OS bookworm or trixie, this is ${PRETTY_NAME:-unknown}; trying anyway" >&2 ;;
esac

echo "install: Debian packages"
export DEBIAN_FRONTEND=noninteractive
apt-get update -qq
# picamera2, lgpio and numpy must be Debian's: picamera2 is built against that numpy, and lgpio has no wheel for Python 3.13.
apt-get install -y -qq --no-install-recommends python3-venv python3-numpy python3-picamera2 python3-lgpio python3-smbus2 \
  avrdude make gcc-avr avr-libc arduino-core-avr >/dev/null

echo "install: $target"
umask 022
# Root runs what is in there, now and at the next update: only root may write it. The service has /var/lib/sentinel.
if [ -d "$target" ] && [ "$(stat -c %U "$target")" != root ]; then
  old="$target.before-$(date +%Y%m%d-%H%M%S)"
  systemctl stop sentinel-robot 2>/dev/null || true  # usermod refuses while the user has processes
  mv "$target" "$old"
  echo "install: an earlier release gave $target to $user; it is $old now, delete it when you like"
  usermod --home "$state" --shell /usr/sbin/nologin "$user"
fi
getent passwd "$user" >/dev/null || useradd --system --no-create-home --home-dir "$state" --shell /usr/sbin/nologin "$user"
usermod -aG dialout,video,gpio,i2c "$user" 2>/dev/null || usermod -aG dialout,video "$user"
install -d -m 755 -o root -g root "$target"  # whoever logs in runs the check
[ -x "$target/venv/bin/python" ] || python3 -m venv --system-site-packages "$target/venv"
# Debian's numpy stays: pip may add, not replace.
numpy=$(/usr/bin/python3 -c 'import numpy; print(numpy.__version__)')
echo "numpy==$numpy" >"$target/constraints.txt"
SENTINEL_NO_PAGE=1 "$target/venv/bin/pip" install --quiet --upgrade -c "$target/constraints.txt" "$here[robot]" gpiozero

echo "install: serial port /dev/sentinel-mega"
install -m 644 "$here/robot/setup/60-sentinel-mega.rules" /etc/udev/rules.d/
udevadm control --reload && udevadm trigger --subsystem-match=tty || true

[ -f /etc/sentinel/robot.toml ] || install -D -m 644 "$here/robot/setup/robot.toml" /etc/sentinel/robot.toml

# The Pi restarts by itself when Linux hangs: systemd feeds the hardware watchdog.
install -D -m 644 "$here/robot/setup/watchdog.conf" /etc/systemd/system.conf.d/sentinel-watchdog.conf

echo "install: access control in $state"
# A file of an earlier release has no such section, and robot-server would not start without one.
grep -q '^\[access\]' /etc/sentinel/robot.toml || printf '\n[access]\nfolder = "/var/lib/sentinel"\n' >>/etc/sentinel/robot.toml
install -d -m 700 -o "$user" -g "$user" "$state"
as_robot() { runuser -u "$user" -- "$target/venv/bin/robot-server" "$@" --folder "$state"; }
as_robot access init

if [ "$service" = yes ]; then
  echo "install: service"
  install -m 644 "$here/robot/setup/sentinel-robot.service" /etc/systemd/system/
  systemctl daemon-reexec  # reads the unit, and starts to feed the hardware watchdog
  systemctl enable --quiet sentinel-robot
  systemctl restart --no-block sentinel-robot  # it is ready only with a Mega that is flashed
fi
echo "install: $(as_robot pair)"
echo "install: done. Flash the Mega once: make -C firmware && make -C firmware upload"
echo "install: then test each part:  sudo systemctl stop sentinel-robot && $target/venv/bin/robot-server --devices pi --config /etc/sentinel/robot.toml --check"
