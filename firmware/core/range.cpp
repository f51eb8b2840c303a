#include "range.h"

namespace sentinel {

void RangeFinder::configure(const ConfigRange& config) {
  if (config.period_ms == period_ms_) return;  // a Pi that joins repeats it: no measurement ends for that
  period_ms_ = config.period_ms;
  is_new_ = true;
  phase_ = Phase::IDLE;
}

bool RangeFinder::next(uint32_t now_ms, uint32_t now_us, bool echo_is_high) {
  if (period_ms_ == 0) return false;
  if (is_new_) {
    is_new_ = false;
    asked_ms_ = due_ms_ = now_ms;
  }
  const uint32_t since_ms = now_ms - asked_ms_;
  switch (phase_) {
    case Phase::ASKED:
      if (since_ms >= ANSWER_MS) end(Echo::SILENT, now_us, 0);
      return false;
    case Phase::SOUNDS:
      if (since_ms >= GIVE_UP_MS) end(Echo::NONE, now_us, 0);
      return false;
    case Phase::ENDED:
      return false;
    case Phase::IDLE:
      break;
  }
  if (static_cast<int32_t>(now_ms - due_ms_) < 0) return false;
  if (echo_is_high) {
    if (since_ms >= HELD_MS) {
      due_ms_ = now_ms + HELD_MS;
      end(Echo::SILENT, now_us, 0);
    }
    return false;
  }
  asked_ms_ = now_ms;
  due_ms_ = now_ms + period_ms_;
  phase_ = Phase::ASKED;
  return true;
}

bool RangeFinder::edge(uint32_t t_us) {
  if (phase_ == Phase::ASKED) {
    rose_us_ = t_us;
    phase_ = Phase::SOUNDS;
    return true;
  }
  if (phase_ != Phase::SOUNDS) return false;
  const uint32_t echo_us = t_us - rose_us_;
  if (echo_us > MAX_ECHO_US) {
    end(Echo::NONE, t_us, 0);
  } else if (echo_us < MIN_ECHO_US) {
    end(Echo::SILENT, t_us, 0);
  } else {
    end(Echo::HEARD, rose_us_ + echo_us / 2, static_cast<uint16_t>(echo_us));
  }
  return false;
}

void RangeFinder::end(Echo echo, uint32_t t_us, uint16_t echo_us) {
  packet_.t_us = t_us;
  packet_.echo_us = echo_us;
  packet_.echo = echo;
  phase_ = Phase::ENDED;
}

bool RangeFinder::take(RangePacket* packet) {
  if (phase_ != Phase::ENDED) return false;
  phase_ = Phase::IDLE;
  *packet = packet_;
  ++packet_.sequence;
  return true;
}

}  // namespace sentinel
