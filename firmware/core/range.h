// An HC-SR04: a pulse on its TRIG makes it sound, and its ECHO is then high for as long as the sound is on its way. No
// waiting, no pins, no clock of its own: whoever has them calls next() from the main loop and edge() from an interrupt.
#pragma once
#include <stdint.h>

#include "protocol.h"

namespace sentinel {

// The sensor raises ECHO half a millisecond after TRIG, its copies within a few.
const uint16_t ANSWER_MS = 10;
// 4.1 m, a little beyond what it is sold for. Without an echo it holds ECHO for 38 ms, some copies for 200.
const uint16_t MAX_ECHO_US = 24000;
const uint16_t MIN_ECHO_US = 100;  // 1.7 cm, nearer than it measures: shorter is a wire that catches the motors' switching
const uint16_t GIVE_UP_MS = 30;   // after TRIG: a longer echo counts as none
const uint16_t HELD_MS = 300;     // ECHO high for longer after TRIG is no sensor: our pull-up holds a wire that ends nowhere

class RangeFinder {
 public:
  // All with interrupts off, or from one.

  // True: ECHO's rise is awaited from now on, pulse TRIG.
  bool next(uint32_t now_ms, uint32_t now_us, bool echo_is_high);
  // ECHO rose, or fell, at t_us. True while its fall is still awaited: without that, no edge interests anybody, so that
  // a wire that rings costs two interrupts a measurement and no more.
  bool edge(uint32_t t_us);
  // True once per measurement.
  bool take(RangePacket* packet);
  void configure(const ConfigRange& config);
  // Main loop only, which alone configures.
  bool is_on() const { return period_ms_ != 0; }

 private:
  enum class Phase : uint8_t { IDLE, ASKED, SOUNDS, ENDED };

  void end(Echo echo, uint32_t t_us, uint16_t echo_us);

  uint8_t period_ms_ = 0;  // 0: there is no sensor
  bool is_new_ = false;
  Phase phase_ = Phase::IDLE;
  uint32_t asked_ms_ = 0;
  uint32_t due_ms_ = 0;
  uint32_t rose_us_ = 0;
  RangePacket packet_ = {0, 0, 0, Echo::SILENT};
};

}  // namespace sentinel
