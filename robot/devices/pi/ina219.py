"""Battery voltage by an INA219 on the Pi's I2C. The only file that imports smbus2."""

from __future__ import annotations

from typing import Any

from robot.devices.pi.mega_parts import battery_state
from robot.devices.ports import BatteryState
from shared.errors import DeviceLost, DeviceUnavailable

REG_BUS_VOLTAGE = 0x02
VOLT_PER_COUNT = 0.004  # INA219 datasheet SBOS448G, section 8.6.3.2: bits 15..3, 4 mV each


class Ina219Battery:
    """Reads the bus voltage, that is the battery's."""

    def __init__(self, bus: int, address: int, empty_v: float, full_v: float) -> None:
        self._address, self._empty_v, self._full_v = address, empty_v, full_v
        try:
            from smbus2 import SMBus
        except ImportError as exc:
            raise DeviceUnavailable("the INA219 needs smbus2; run robot/install.sh on the Pi") from exc
        try:
            self._bus: Any = SMBus(bus)
        except OSError as exc:
            raise DeviceUnavailable(f"I2C bus {bus} cannot be opened ({exc}); enable it with raspi-config") from exc

    def read(self) -> BatteryState:
        try:
            low_first: int = self._bus.read_word_data(self._address, REG_BUS_VOLTAGE)
        except OSError as exc:
            raise DeviceLost(f"no INA219 answers at 0x{self._address:02x} ({exc}); check its wires") from exc
        raw = (low_first & 0xFF) << 8 | low_first >> 8  # SMBus words are low byte first, the chip sends high first
        return battery_state((raw >> 3) * VOLT_PER_COUNT, self._empty_v, self._full_v)
