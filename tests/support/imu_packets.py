"""What the Mega's bursts hold beside gyro and accelerometer: the firmware sends it, the robot does not use it yet."""

import struct

from shared.serial_protocol import ImuPacket

MAG = struct.Struct("<BhhhBB")  # ST1, x, y, z, reserved, ST2; little-endian, behind the burst's big-endian part
MAG_UT_PER_COUNT = 0.15  # AK09916 datasheet, table 5


def temperature_c(packet: ImuPacket) -> float:
    """Chip temperature, deg C (DS-000189, section 8.33)."""
    return packet.raw()[6] / 333.87 + 21.0


def mag_imu(packet: ImuPacket) -> tuple[float, float, float] | None:
    """Field in uT in the IMU's axes; None where the magnetometer had nothing new or was saturated.

    The AK09916 inside the chip has its y and z against those of accelerometer and gyro (DS-000189, figure 12).
    """
    st1, x, y, z, _, st2 = MAG.unpack_from(packet.burst, ImuPacket.BURST.size)
    if not st1 & 1 or st2 & 8:
        return None
    return x * MAG_UT_PER_COUNT, -y * MAG_UT_PER_COUNT, -z * MAG_UT_PER_COUNT
