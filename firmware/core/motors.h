// What the motors may do: time to live, ramps, battery cut-off. tick() runs in a timer interrupt, 1000 times a second.
#pragma once
#include <stdint.h>

#include "protocol.h"

namespace sentinel {

// Longest silence the motors survive, whatever a command asks for: with 100 ms to spare to the 500 ms bound.
const uint16_t MAX_TTL_MS = 400;
// No command ends so much later, unless its sender takes our clock for another one. More than MAX_TTL_MS, because an
// emulated Mega is at times behind the clock that it told.
const uint16_t MAX_AHEAD_MS = 1000;
const int16_t FULL = 1000;  // permille
const uint16_t BRAKE_MS = 300;
const uint16_t LOW_BATTERY_MS = 2000;       // a start-up dip of the motors is shorter
const uint16_t BATTERY_HYSTERESIS_MV = 300;

enum class Bridge : uint8_t { COAST, BRAKE, RUN };

class MotorControl {
 public:
  // From the main loop, with interrupts off. Commands never move a motor by themselves: tick() does.
  // False where the command's time is over, however long it took to come here: then nothing has changed.
  bool command(const Drive& drive, uint32_t now_ms);
  void stop();
  void configure(const ConfigMotors& config);
  void battery(uint16_t mv) { battery_mv_ = mv; }

  // From the timer interrupt.
  void tick();

  int16_t left() const { return left_; }
  int16_t right() const { return right_; }
  Bridge bridge() const { return bridge_; }
  bool slow_decay() const { return config_.slow_decay != 0; }
  bool driving() const { return ttl_ms_ != 0; }
  bool ttl_stop() const { return ttl_stop_; }
  uint16_t ttl_stops() const { return ttl_stops_; }
  bool low_battery() const { return low_battery_; }

 private:
  void halt();
  void watch_battery();
  int16_t ramp(int16_t now, int16_t target) const;

  ConfigMotors config_ = {1, 4, 10, 0};  // 0 to full in 250 ms, back in 100 ms
  int16_t target_left_ = 0, target_right_ = 0;
  int16_t left_ = 0, right_ = 0;
  uint16_t ttl_ms_ = 0;
  uint16_t brake_ms_ = 0;
  uint16_t battery_mv_ = 0;
  uint16_t low_ms_ = 0;
  uint16_t ttl_stops_ = 0;
  bool ttl_stop_ = false;
  bool low_battery_ = false;
  Bridge bridge_ = Bridge::COAST;
};

// Counts of a PWM period that `permille` (0..1000) is high: 0 is off, PWM_COUNTS is on throughout. In 16 bits, since a
// 32-bit division takes the AVR 40 us and this runs in the tick; what is less than a count is none.
const uint16_t PWM_COUNTS = 800;
inline uint16_t pwm_counts(uint16_t permille) { return static_cast<uint16_t>(permille * 4u / 5u); }

// The two inputs of one DRV8833 bridge, counts of high time each (DRV8833 datasheet, table 2).
struct BridgeInputs {
  uint16_t in1, in2;
};
BridgeInputs bridge_inputs(Bridge bridge, int16_t speed, bool slow_decay);

}  // namespace sentinel
