#include "imu.h"

namespace sentinel {

namespace {

const uint8_t WHO_AM_I = 0xEA;
const uint8_t REG_BANK_SEL = 0x7F;
const uint8_t ACCEL_XOUT_H = 0x2D;
const uint8_t I2C_MST_STATUS = 0x17;
const uint8_t SLV4_DONE = 0x40;
const uint32_t PROBE_PERIOD_MS = 100;
const uint32_t SILENCE_MS = 200;     // 45 samples without a data-ready: the chip lost its power or its set-up
const uint8_t ERRORS_TO_RESTART = 3;
const uint8_t MAX_MAG_POLLS = 20;

// Values that come from the configuration or the state.
enum : uint8_t { FIXED, GYRO_DIV, GYRO_CONFIG, ACCEL_DIV, ACCEL_CONFIG };

struct Step {
  uint8_t bank, reg, value;
  uint8_t source;
  uint8_t wait_ms;  // after it
  bool mag;         // poll I2C_MST_STATUS until the aux transfer is done
};

// The AK09916 hangs on the chip's own I2C master: slave 4 does single writes, slave 0 repeats the read of ST1..ST2.
const Step SETUP[] = {
    {0, 0x06, 0x01, FIXED, 35, false},        // PWR_MGMT_1: awake, best clock; gyro start-up 35 ms
    {0, 0x07, 0x00, FIXED, 0, false},         // PWR_MGMT_2: all axes on
    {0, 0x05, 0x00, FIXED, 0, false},         // LP_CONFIG: the aux master follows the gyro's rate
    {2, 0x00, 0, GYRO_DIV, 0, false},         // GYRO_SMPLRT_DIV
    {2, 0x01, 0, GYRO_CONFIG, 0, false},      // GYRO_CONFIG_1
    {2, 0x10, 0x00, FIXED, 0, false},         // ACCEL_SMPLRT_DIV_1
    {2, 0x11, 0, ACCEL_DIV, 0, false},        // ACCEL_SMPLRT_DIV_2
    {2, 0x14, 0, ACCEL_CONFIG, 0, false},     // ACCEL_CONFIG
    {2, 0x09, 0x01, FIXED, 0, false},         // ODR_ALIGN_EN: gyro and accel of one instant
    {0, 0x03, 0x20, FIXED, 1, false},         // USER_CTRL: aux master on
    {3, 0x01, 0x17, FIXED, 0, false},         // I2C_MST_CTRL: stop between reads, 345.6 kHz
    {3, 0x13, 0x0C, FIXED, 0, false},         // slave 4 writes to the AK09916:
    {3, 0x14, 0x32, FIXED, 0, false},         // CNTL3
    {3, 0x16, 0x01, FIXED, 0, false},         // soft reset
    {3, 0x15, 0x80, FIXED, 0, true},          // go
    {3, 0x14, 0x31, FIXED, 0, false},         // CNTL2
    {3, 0x16, 0x08, FIXED, 0, false},         // continuous, 100 Hz
    {3, 0x15, 0x80, FIXED, 0, true},          // go
    {3, 0x03, 0x8C, FIXED, 0, false},         // slave 0 reads from the AK09916,
    {3, 0x04, 0x10, FIXED, 0, false},         // from ST1
    {3, 0x05, 0x89, FIXED, 0, false},         // 9 bytes, through ST2: reading ST2 frees the next measurement
    {0, 0x0F, 0x10, FIXED, 0, false},         // INT_PIN_CFG: active high, 50 us pulse, cleared by any read
    {0, 0x11, 0x01, FIXED, 0, false},         // INT_ENABLE_1: raw data ready
};
const uint8_t SETUP_STEPS = sizeof(SETUP) / sizeof(SETUP[0]);

// FCHOICE 1 (filter on), full scale, filter: GYRO_CONFIG_1 and ACCEL_CONFIG share this layout.
uint8_t scale_bits(uint8_t filter, uint8_t scale) { return static_cast<uint8_t>(filter << 3 | scale << 1 | 1); }

bool reached(uint32_t now_ms, uint32_t when_ms) { return static_cast<int32_t>(now_ms - when_ms) >= 0; }

}  // namespace

static bool same(const ConfigImu& a, const ConfigImu& b) {
  return a.gyro_scale == b.gyro_scale && a.accel_scale == b.accel_scale && a.gyro_filter == b.gyro_filter &&
         a.accel_filter == b.accel_filter && a.divider == b.divider;
}

uint8_t Icm20948::value_of(uint8_t step) const {
  switch (SETUP[step].source) {
    case GYRO_DIV:
    case ACCEL_DIV:
      return config_.divider;
    case GYRO_CONFIG:
      return scale_bits(config_.gyro_filter, config_.gyro_scale);
    case ACCEL_CONFIG:
      return scale_bits(config_.accel_filter, config_.accel_scale);
    default:
      return SETUP[step].value;
  }
}

// An operation may be on the bus, and its result belongs to the state that asked for it.
void Icm20948::configure(const ConfigImu& config) { wanted_ = config; }

void Icm20948::restart(uint32_t now_ms) {
  state_ = State::PROBE;
  pending_ = false;
  reading_ = false;
  bank_ = 0xFF;
  in_a_row_ = 0;
  wait_until_ms_ = now_ms;
}

bool Icm20948::next(uint32_t now_ms, BusOp* op) {
  bank_op_ = false;
  if (!same(wanted_, config_)) {  // a Pi that joins with the present one must not interrupt the stream
    config_ = wanted_;
    restart(now_ms);
  }
  if (state_ == State::RUN) {
    if (pending_) {
      // Stamp and number belong together, and the interrupt may come between any two lines here.
      do {
        pending_ = false;
        packet_.sequence = samples_ - 1;
        packet_.t_us = ready_us_;
      } while (pending_);
      reading_ = true;
      last_sample_ms_ = now_ms;
      *op = read_register(ACCEL_XOUT_H, IMU_BURST);
      return true;
    }
    if (reached(now_ms, last_sample_ms_ + SILENCE_MS)) {
      ++errors_;
      last_error_ms_ = now_ms;
      restart(now_ms);
    }
    return false;
  }
  if (!reached(now_ms, wait_until_ms_)) return false;
  if (state_ == State::PROBE) {
    // The bank may be any after a reset of only one of the two chips.
    if (bank_ != 0) {
      *op = write_register(REG_BANK_SEL, 0);
      bank_op_ = true;
    } else {
      *op = read_register(0x00, 1);
    }
    return true;
  }
  if (state_ == State::RESET) {
    *op = write_register(0x06, 0x80);
    return true;
  }
  return next_setup(now_ms, op);
}

bool Icm20948::next_setup(uint32_t, BusOp* op) {
  const uint8_t bank = state_ == State::MAG_POLL ? 0 : SETUP[step_].bank;
  if (bank != bank_) {
    *op = write_register(REG_BANK_SEL, static_cast<uint8_t>(bank << 4));
    bank_op_ = true;
  } else if (state_ == State::MAG_POLL) {
    *op = read_register(I2C_MST_STATUS, 1);
  } else {
    *op = write_register(SETUP[step_].reg, value_of(step_));
  }
  return true;
}

void Icm20948::fail(uint32_t now_ms) {
  ++errors_;
  last_error_ms_ = now_ms;
  bank_ = 0xFF;
  if (state_ == State::PROBE) {
    address_ = address_ == 0x69 ? 0x68 : 0x69;
    wait_until_ms_ = now_ms + PROBE_PERIOD_MS;
  } else if (state_ != State::RUN || ++in_a_row_ >= ERRORS_TO_RESTART) {
    restart(now_ms + PROBE_PERIOD_MS);
  } else {
    bank_ = 0;  // RUN stays in bank 0
  }
}

void Icm20948::done(uint32_t now_ms, bool ok, const uint8_t* data) {
  const bool was_reading = reading_;
  reading_ = false;
  if (!ok) {
    fail(now_ms);
    return;
  }
  in_a_row_ = 0;
  if (bank_op_) {
    bank_ = state_ == State::PROBE || state_ == State::MAG_POLL ? 0 : SETUP[step_].bank;
    return;
  }
  switch (state_) {
    case State::PROBE:
      who_ = data[0];
      if (who_ == WHO_AM_I) {
        state_ = State::RESET;
      } else {
        fail(now_ms);
      }
      break;
    case State::RESET:
      state_ = State::SETUP;
      step_ = 0;
      bank_ = 0;
      mag_present_ = true;
      wait_until_ms_ = now_ms + 101;  // start-up of registers after reset: 100 ms at most
      break;
    case State::SETUP:
      wait_until_ms_ = now_ms + SETUP[step_].wait_ms + (SETUP[step_].mag ? 1 : 0);
      if (SETUP[step_].mag) {
        state_ = State::MAG_POLL;
        mag_polls_ = 0;
      } else {
        ++step_;
      }
      break;
    case State::MAG_POLL:
      if (data[0] & SLV4_DONE) {
        if (data[0] & 0x10) mag_present_ = false;  // SLV4_NACK
        state_ = State::SETUP;
        ++step_;
        wait_until_ms_ = now_ms + 2;  // AK09916 after a soft reset
      } else if (++mag_polls_ >= MAX_MAG_POLLS) {
        mag_present_ = false;  // gyro and accel work without it
        state_ = State::SETUP;
        ++step_;
      } else {
        wait_until_ms_ = now_ms + 1;
      }
      break;
    case State::RUN:
      // A newer sample may have come before the chip gave this one out: the stamp and the bytes could be of two samples.
      // It is lost then, and counted; the newer one is read next.
      if (was_reading && !pending_) {
        packet_.scales = static_cast<uint8_t>(config_.gyro_scale | config_.accel_scale << 4);
        for (uint8_t i = 0; i < IMU_BURST; ++i) packet_.burst[i] = data[i];
        have_packet_ = true;
      }
      break;
  }
  if (state_ == State::SETUP && step_ == SETUP_STEPS) {
    // The chip went on, or stood, for an unknown number of samples: one number stays out, so that the Pi sees a hole.
    // No interrupt counts here: data_ready() does so in RUN only.
    if (starts_ != 0) samples_ = samples_ + 1;
    state_ = State::RUN;
    ++starts_;
    last_sample_ms_ = now_ms;
  }
}

void Icm20948::data_ready(uint32_t t_us) {
  if (state_ != State::RUN) return;
  samples_ = samples_ + 1;
  ready_us_ = t_us;
  pending_ = true;
}

bool Icm20948::take(ImuPacket* packet) {
  if (!have_packet_) return false;
  have_packet_ = false;
  *packet = packet_;
  return true;
}

}  // namespace sentinel
