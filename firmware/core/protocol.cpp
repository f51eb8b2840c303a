#include "protocol.h"

#include "cobs.h"
#include "crc16.h"

namespace sentinel {

uint8_t pack(const Hello& m, uint8_t* out) {
  Writer w(out, Type::HELLO);
  w.u8(m.version);
  w.u8(m.firmware_major);
  w.u8(m.firmware_minor);
  w.u8(m.reset_cause);
  w.u8(m.imu_address);
  w.u8(m.imu_who);
  w.u8(m.gyro_scale);
  w.u8(m.accel_scale);
  w.u8(m.gyro_filter);
  w.u8(m.accel_filter);
  w.u8(m.divider);
  w.u16(m.boot_id);
  return w.length();
}

uint8_t pack(const ImuPacket& m, uint8_t* out) {
  Writer w(out, Type::IMU);
  w.u32(m.sequence);
  w.u32(m.t_us);
  w.u8(m.scales);
  w.bytes(m.burst, IMU_BURST);
  return w.length();
}

uint8_t pack(const Status& m, uint8_t* out) {
  Writer w(out, Type::STATUS);
  w.u32(m.uptime_ms);
  w.u16(m.flags);
  w.u32(m.samples);
  w.u32(m.samples_lost);
  w.u16(m.bus_errors);
  w.u16(m.bus_recoveries);
  w.u16(m.imu_starts);
  w.u16(m.rx_frames);
  w.u16(m.rx_bad);
  w.u16(m.rx_overruns);
  w.u16(m.tx_dropped);
  w.u16(m.ttl_stops);
  w.u16(m.battery_mv);
  w.u16(static_cast<uint16_t>(m.left));
  w.u16(static_cast<uint16_t>(m.right));
  w.u16(m.loop_max_us);
  w.u16(m.stack_free);
  return w.length();
}

uint8_t pack_ack(uint8_t asked, Result result, uint8_t* out) {
  Writer w(out, Type::ACK);
  w.u8(asked);
  w.u8(static_cast<uint8_t>(result));
  return w.length();
}

uint8_t pack_time(uint32_t token, uint32_t t_us, uint8_t* out) {
  Writer w(out, Type::TIME);
  w.u32(token);
  w.u32(t_us);
  return w.length();
}

uint8_t pack_quaternion(uint32_t sequence, uint32_t t_us, const int32_t* q_wxyz, uint8_t* out) {
  Writer w(out, Type::QUATERNION);
  w.u32(sequence);
  w.u32(t_us);
  for (uint8_t i = 0; i < 4; ++i) w.u32(static_cast<uint32_t>(q_wxyz[i]));
  return w.length();
}

uint8_t pack(const RangePacket& m, uint8_t* out) {
  Writer w(out, Type::RANGE);
  w.u16(m.sequence);
  w.u32(m.t_us);
  w.u16(m.echo_us);
  w.u8(static_cast<uint8_t>(m.echo));
  return w.length();
}

// A drive body repeats its bytes inverted: among 65536 damaged frames one passes a CRC-16, and it must not move a robot.
static const uint8_t DRIVE_BYTES = 10;
Result parse(const uint8_t* body, uint8_t length, Drive* m) {
  if (length != 2 * DRIVE_BYTES) return Result::BAD_LENGTH;
  for (uint8_t i = 0; i < DRIVE_BYTES; ++i) {
    if ((body[i] ^ body[i + DRIVE_BYTES]) != 0xFF) return Result::BAD_VALUE;
  }
  m->left = static_cast<int16_t>(read_u16(body));
  m->right = static_cast<int16_t>(read_u16(body + 2));
  m->until_ms = read_u32(body + 4);
  m->boot_id = read_u16(body + 8);
  if (m->left < -1000 || m->left > 1000 || m->right < -1000 || m->right > 1000) return Result::BAD_VALUE;
  return Result::DONE;
}

Result parse(const uint8_t* body, uint8_t length, ConfigImu* m) {
  if (length != 5) return Result::BAD_LENGTH;
  m->gyro_scale = body[0];
  m->accel_scale = body[1];
  m->gyro_filter = body[2];
  m->accel_filter = body[3];
  m->divider = body[4];
  // Divider 2 (375 Hz) is the fastest that leaves the bus idle a third of the time.
  if (m->gyro_scale > 3 || m->accel_scale > 3 || m->gyro_filter > 7 || m->accel_filter > 7 || m->divider < 2) {
    return Result::BAD_VALUE;
  }
  return Result::DONE;
}

Result parse(const uint8_t* body, uint8_t length, ConfigMotors* m) {
  if (length != 5) return Result::BAD_LENGTH;
  m->slow_decay = body[0];
  m->ramp_up = body[1];
  m->ramp_down = body[2];
  m->cutoff_mv = read_u16(body + 3);
  if (m->slow_decay > 1 || m->ramp_up == 0 || m->ramp_down == 0 || m->cutoff_mv > 20000) return Result::BAD_VALUE;
  return Result::DONE;
}

static bool is_pulse(uint16_t us) { return us == 0 || (us >= 500 && us <= 2500); }

Result parse(const uint8_t* body, uint8_t length, Servo* m) {
  if (length != 4) return Result::BAD_LENGTH;
  m->pan_us = read_u16(body);
  m->tilt_us = read_u16(body + 2);
  return is_pulse(m->pan_us) && is_pulse(m->tilt_us) ? Result::DONE : Result::BAD_VALUE;
}

Result parse(const uint8_t* body, uint8_t length, ConfigRange* m) {
  if (length != 1) return Result::BAD_LENGTH;
  m->period_ms = body[0];
  return m->period_ms == 0 || (m->period_ms >= 50 && m->period_ms <= 250) ? Result::DONE : Result::BAD_VALUE;
}

uint8_t encode_frame(const uint8_t* payload, uint8_t length, uint8_t* out) {
  uint8_t with_crc[MAX_PAYLOAD + 2];
  for (uint8_t i = 0; i < length; ++i) with_crc[i] = payload[i];
  const uint16_t crc = crc16(payload, length);
  with_crc[length] = static_cast<uint8_t>(crc);
  with_crc[length + 1] = static_cast<uint8_t>(crc >> 8);
  const uint8_t encoded = cobs_encode(with_crc, static_cast<uint8_t>(length + 2), out);
  out[encoded] = 0;
  return static_cast<uint8_t>(encoded + 1);
}

bool FrameParser::feed(uint8_t byte) {
  if (byte != 0) {
    if (used_ < sizeof(buffer_)) {
      buffer_[used_++] = byte;
    } else {
      overflow_ = true;
    }
    return false;
  }
  const uint8_t received = used_;
  const bool overflow = overflow_;
  used_ = 0;
  overflow_ = false;
  if (received == 0) return false;  // idle delimiters are no error: a sender may lead with one
  const int16_t decoded = overflow ? -1 : cobs_decode(buffer_, received);
  if (decoded < 3 || decoded > MAX_PAYLOAD + 2) {
    ++bad_;
    return false;
  }
  length_ = static_cast<uint8_t>(decoded - 2);
  if (crc16(buffer_, length_) != read_u16(buffer_ + length_)) {
    ++bad_;
    return false;
  }
  ++frames_;
  return true;
}

}  // namespace sentinel
