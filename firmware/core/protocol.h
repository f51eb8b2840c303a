// Frames between the Mega and the Pi: COBS(type, body, CRC-16 low byte first), 0x00. Numbers are little-endian.
// The Python twin is shared/serial_protocol.py; tests/golden/serial_frames.txt holds bytes both must produce.
#pragma once
#include <stdint.h>

namespace sentinel {

const uint8_t PROTOCOL_VERSION = 2;
const uint8_t MAX_PAYLOAD = 80;               // type + body
const uint8_t MAX_FRAME = MAX_PAYLOAD + 4;    // CRC, COBS code, delimiter
const uint8_t IMU_BURST = 23;                 // accel 6, gyro 6, temperature 2, magnetometer ST1..ST2 9

enum class Type : uint8_t {
  // Mega to Pi
  HELLO = 0x01,
  IMU = 0x02,
  STATUS = 0x03,
  ACK = 0x04,
  TIME = 0x05,
  QUATERNION = 0x06,  // only with the DMP option (docs/firmware.md)
  RANGE = 0x07,       // only where CONFIG_RANGE asked for it, so that no older Pi gets one
  // Pi to Mega
  DRIVE = 0x10,
  STOP = 0x11,
  ASK_TIME = 0x12,
  ASK_HELLO = 0x13,
  CONFIG_IMU = 0x14,
  CONFIG_MOTORS = 0x15,
  SERVO = 0x16,
  CONFIG_RANGE = 0x17,  // firmware 2.1; an older one answers UNKNOWN_TYPE
};

enum class Result : uint8_t { DONE = 0, BAD_LENGTH = 1, BAD_VALUE = 2, UNKNOWN_TYPE = 3, TOO_LATE = 4 };

// Bits of Status::flags.
enum : uint16_t {
  FLAG_IMU_MISSING = 1 << 0,
  FLAG_MAG_MISSING = 1 << 1,
  FLAG_BUS_ERROR = 1 << 2,      // an I2C error within the last second
  FLAG_LOW_BATTERY = 1 << 3,    // motors are held off
  FLAG_DRIVER_FAULT = 1 << 4,   // DRV8833 pulls nFAULT: overcurrent, overheat, undervoltage
  FLAG_DRIVING = 1 << 5,        // a drive command is fresh
  FLAG_TTL_STOP = 1 << 6,       // the last stop was made by the watchdog
};

struct Hello {
  uint8_t version;
  uint8_t firmware_major, firmware_minor;
  // Bits of MCUSR: 1 power on, 2 reset line (DTR), 4 brown-out, 8 watchdog. The stock bootloader clears it: 0 is then
  // any of the first three; a watchdog reset is told as 8 all the same unless the firmware hung with interrupts off.
  uint8_t reset_cause;
  uint8_t imu_address;  // 0 while none was found
  uint8_t imu_who;
  uint8_t gyro_scale, accel_scale, gyro_filter, accel_filter, divider;
  uint16_t boot_id;  // counts resets since power on, so that the Pi notices one
};

struct ImuPacket {
  uint32_t sequence;
  uint32_t t_us;
  uint8_t scales;  // gyro_scale | accel_scale << 4: a packet can be read alone
  uint8_t burst[IMU_BURST];
};

struct Status {
  uint32_t uptime_ms;
  uint16_t flags;
  uint32_t samples;        // data-ready interrupts, and one for each set-up of the IMU after the first
  uint32_t samples_lost;   // of these, neither sent nor on their way
  uint16_t bus_errors, bus_recoveries, imu_starts;
  uint16_t rx_frames, rx_bad, rx_overruns, tx_dropped;
  uint16_t ttl_stops;
  uint16_t battery_mv;
  int16_t left, right;      // permille at the pins
  uint16_t loop_max_us;     // since the last status
  uint16_t stack_free;      // bytes never touched
};

struct Drive {
  int16_t left, right;  // permille, -1000..1000
  uint32_t until_ms;    // our uptime at which it ends
  uint16_t boot_id;     // whose uptime: another boot's says nothing
};

struct ConfigImu {
  uint8_t gyro_scale, accel_scale;    // 0..3: 250..2000 deg/s, 2..16 g
  uint8_t gyro_filter, accel_filter;  // DLPFCFG 0..7
  uint8_t divider;                    // rate = 1125 / (1 + divider) Hz
};

struct ConfigMotors {
  uint8_t slow_decay;     // 1: brake between pulses, 0: coast
  uint8_t ramp_up;        // permille per ms, 1..255
  uint8_t ramp_down;
  uint16_t cutoff_mv;     // 0: no battery sensed
};

struct Servo {
  uint16_t pan_us, tilt_us;  // pulse width 500..2500; 0 lets the servo go
};

enum class Echo : uint8_t {
  HEARD = 0,
  NONE = 1,    // nothing in reach, or nothing that sends sound back
  SILENT = 2,  // the sensor does not answer
};

struct RangePacket {
  uint16_t sequence;
  uint32_t t_us;     // when the sound turned round; of no echo, when that was known
  uint16_t echo_us;  // there and back; 0 where none was heard
  Echo echo;
};

struct ConfigRange {
  uint8_t period_ms;  // 50..250 from one measurement to the next, so that no echo is taken for a later one's; 0: no sensor
};

// Little-endian writer and reader over a byte array that is known to be long enough.
class Writer {
 public:
  Writer(uint8_t* at, Type type) : start_(at), at_(at) { u8(static_cast<uint8_t>(type)); }
  void u8(uint8_t v) { *at_++ = v; }
  void u16(uint16_t v) {
    u8(static_cast<uint8_t>(v));
    u8(static_cast<uint8_t>(v >> 8));
  }
  void u32(uint32_t v) {
    u16(static_cast<uint16_t>(v));
    u16(static_cast<uint16_t>(v >> 16));
  }
  void bytes(const uint8_t* data, uint8_t n) {
    for (uint8_t i = 0; i < n; ++i) u8(data[i]);
  }
  uint8_t length() const { return static_cast<uint8_t>(at_ - start_); }

 private:
  uint8_t* start_;
  uint8_t* at_;
};

inline uint16_t read_u16(const uint8_t* at) { return static_cast<uint16_t>(at[0] | static_cast<uint16_t>(at[1]) << 8); }
inline uint32_t read_u32(const uint8_t* at) {
  return read_u16(at) | static_cast<uint32_t>(read_u16(at + 2)) << 16;
}

// Payloads (type + body) into `out` of MAX_PAYLOAD bytes; return their length.
uint8_t pack(const Hello& m, uint8_t* out);
uint8_t pack(const ImuPacket& m, uint8_t* out);
uint8_t pack(const Status& m, uint8_t* out);
uint8_t pack_ack(uint8_t asked, Result result, uint8_t* out);
uint8_t pack_time(uint32_t token, uint32_t t_us, uint8_t* out);
uint8_t pack_quaternion(uint32_t sequence, uint32_t t_us, const int32_t* q_wxyz, uint8_t* out);  // Q30, wxyz
uint8_t pack(const RangePacket& m, uint8_t* out);

// Bodies (without type) of commands. DONE where the message was understood and every value is in range.
Result parse(const uint8_t* body, uint8_t length, Drive* m);
Result parse(const uint8_t* body, uint8_t length, ConfigImu* m);
Result parse(const uint8_t* body, uint8_t length, ConfigMotors* m);
Result parse(const uint8_t* body, uint8_t length, Servo* m);
Result parse(const uint8_t* body, uint8_t length, ConfigRange* m);

// Payload to frame with delimiter; `out` has MAX_FRAME bytes. Returns the frame's length.
uint8_t encode_frame(const uint8_t* payload, uint8_t length, uint8_t* out);

// Cuts a byte stream into payloads. Damage costs the frame it hits and at most the one behind it.
class FrameParser {
 public:
  // Takes one byte. True when a whole, valid payload stands at payload() until the next call.
  bool feed(uint8_t byte);
  const uint8_t* payload() const { return buffer_; }
  uint8_t length() const { return length_; }
  uint16_t frames() const { return frames_; }
  uint16_t bad() const { return bad_; }

 private:
  uint8_t buffer_[MAX_FRAME];
  uint8_t used_ = 0;
  uint8_t length_ = 0;
  bool overflow_ = false;
  uint16_t frames_ = 0;
  uint16_t bad_ = 0;
};

}  // namespace sentinel
