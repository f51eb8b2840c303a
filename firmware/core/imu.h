// ICM-20948 with its AK09916 magnetometer as a sequence of bus operations: no waiting, no pins, no clock of its own.
// Registers: TDK DS-000189 v1.3, chapters 8-11; AK09916: AKM 015007392-E-02.
#pragma once
#include <stdint.h>

#include "protocol.h"

namespace sentinel {

// Write `write_length` bytes, then (repeated start) read `read_length`. write_length is at least 1.
struct BusOp {
  uint8_t address;
  uint8_t write_length;
  uint8_t write[2];
  uint8_t read_length;
};

class Icm20948 {
 public:
  enum class State : uint8_t { PROBE, RESET, SETUP, MAG_POLL, RUN };

  // The operation to put on the bus now; false while there is none (waiting for time or for a sample).
  bool next(uint32_t now_ms, BusOp* op);
  // Its outcome. `data` has op.read_length bytes; ok is false on a missing acknowledge or a timeout.
  void done(uint32_t now_ms, bool ok, const uint8_t* data);

  // From the data-ready interrupt (or with it held off).
  void data_ready(uint32_t t_us);
  // True once per burst read: fills everything but `scales`'s meaning, which is in the packet.
  bool take(ImuPacket* packet);
  // The packet taken last is on its way to the Pi; without this call it counts as lost.
  void count_sent() { ++sent_; }

  // At any time: takes effect in next(), when no operation is on the bus.
  void configure(const ConfigImu& config);

  const ConfigImu& config() const { return wanted_; }
  bool running() const { return state_ == State::RUN; }
  bool sample_waits() const { return pending_; }
  bool mag_present() const { return mag_present_; }
  uint8_t address() const { return running() ? address_ : 0; }
  uint8_t who() const { return who_; }
  uint16_t errors() const { return errors_; }
  uint16_t starts() const { return starts_; }
  uint32_t samples() const { return samples_; }
  // Samples that will never be sent; data_ready held off. Each set-up anew counts as one, as its number of samples is unknown.
  uint32_t lost() const { return samples_ - sent_ - pending_ - reading_ - have_packet_; }
  uint32_t last_error_ms() const { return last_error_ms_; }

 private:
  bool next_setup(uint32_t now_ms, BusOp* op);
  BusOp write_register(uint8_t reg, uint8_t value) const { return {address_, 2, {reg, value}, 0}; }
  BusOp read_register(uint8_t reg, uint8_t n) const { return {address_, 1, {reg, 0}, n}; }
  uint8_t value_of(uint8_t step) const;
  void fail(uint32_t now_ms);
  void restart(uint32_t now_ms);

  ConfigImu config_ = {1, 1, 3, 3, 4};  // 500 deg/s, 4 g, 51 and 50 Hz low-pass, 225 Hz
  ConfigImu wanted_ = config_;
  volatile State state_ = State::PROBE;  // the interrupt counts in RUN only
  uint8_t address_ = 0x69;  // SparkFun's breakout; 0x68 with its jumper closed
  uint8_t who_ = 0;
  uint8_t step_ = 0;
  uint8_t bank_ = 0xFF;  // unknown
  bool bank_op_ = false;
  uint8_t in_a_row_ = 0;  // failed operations
  bool mag_present_ = false;
  uint8_t mag_polls_ = 0;
  uint32_t wait_until_ms_ = 0;
  uint32_t last_sample_ms_ = 0;
  uint32_t last_error_ms_ = 0;
  uint16_t errors_ = 0;
  uint16_t starts_ = 0;

  volatile bool pending_ = false;    // a sample waits in the chip
  volatile uint32_t samples_ = 0;
  volatile uint32_t ready_us_ = 0;
  bool reading_ = false;
  bool have_packet_ = false;
  uint32_t sent_ = 0;
  ImuPacket packet_;
};

}  // namespace sentinel
