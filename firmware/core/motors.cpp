#include "motors.h"

namespace sentinel {

bool MotorControl::command(const Drive& drive, uint32_t now_ms) {
  const uint32_t ahead_ms = drive.until_ms - now_ms;  // the past is almost 2^32 ahead
  if (ahead_ms == 0 || ahead_ms > MAX_AHEAD_MS) return false;
  ttl_ms_ = ahead_ms < MAX_TTL_MS ? static_cast<uint16_t>(ahead_ms) : MAX_TTL_MS;
  target_left_ = drive.left;
  target_right_ = drive.right;
  ttl_stop_ = false;
  return true;
}

void MotorControl::stop() {
  halt();
  ttl_stop_ = false;
}

void MotorControl::configure(const ConfigMotors& config) {
  halt();
  // A Pi that joins repeats its configuration: an empty battery stays one.
  if (config.cutoff_mv != config_.cutoff_mv) {
    low_battery_ = false;
    low_ms_ = 0;
  }
  config_ = config;
}

void MotorControl::halt() {
  ttl_ms_ = 0;
  target_left_ = target_right_ = 0;
  if (bridge_ == Bridge::RUN) {
    bridge_ = Bridge::BRAKE;
    brake_ms_ = BRAKE_MS;
  }
  left_ = right_ = 0;
}

void MotorControl::watch_battery() {
  if (config_.cutoff_mv == 0) return;
  if (battery_mv_ < config_.cutoff_mv) {
    if (low_ms_ < LOW_BATTERY_MS) {
      ++low_ms_;
    } else {
      low_battery_ = true;
    }
  } else {
    low_ms_ = 0;
    if (battery_mv_ >= config_.cutoff_mv + BATTERY_HYSTERESIS_MV) low_battery_ = false;
  }
}

int16_t MotorControl::ramp(int16_t now, int16_t target) const {
  // Away from zero counts as speeding up; through zero it slows down first.
  const bool up = (now >= 0 && target > now) || (now <= 0 && target < now);
  const int16_t step = up ? config_.ramp_up : config_.ramp_down;
  const int16_t bound = (!up && ((now > 0 && target < 0) || (now < 0 && target > 0))) ? 0 : target;
  if (bound > now) return static_cast<int16_t>(bound - now > step ? now + step : bound);
  return static_cast<int16_t>(now - bound > step ? now - step : bound);
}

void MotorControl::tick() {
  watch_battery();
  if (ttl_ms_ != 0 && --ttl_ms_ == 0) {
    halt();
    ttl_stop_ = true;
    ++ttl_stops_;
  }
  if (low_battery_ && ttl_ms_ != 0) halt();
  if (ttl_ms_ != 0) {
    left_ = ramp(left_, target_left_);
    right_ = ramp(right_, target_right_);
    bridge_ = Bridge::RUN;
  } else if (bridge_ == Bridge::BRAKE && --brake_ms_ == 0) {
    bridge_ = Bridge::COAST;
  }
}

BridgeInputs bridge_inputs(Bridge bridge, int16_t speed, bool slow_decay) {
  if (bridge == Bridge::COAST) return {0, 0};
  if (bridge == Bridge::BRAKE) return {PWM_COUNTS, PWM_COUNTS};
  const uint16_t size = pwm_counts(static_cast<uint16_t>(speed < 0 ? -speed : speed));
  // Slow decay holds the driving input high and pulses the other low: between pulses the winding is shorted.
  const uint16_t driving = slow_decay ? PWM_COUNTS : size;
  const uint16_t other = slow_decay ? static_cast<uint16_t>(PWM_COUNTS - size) : 0;
  return speed < 0 ? BridgeInputs{other, driving} : BridgeInputs{driving, other};
}

}  // namespace sentinel
