// The 1 kHz interrupt that owns the motors: time to live, ramps and pins, whatever the main loop does.
#include <avr/interrupt.h>

#include "board.h"
#include "motor_pins.h"

sentinel::MotorControl motors;
extern volatile uint32_t clock_ticks_ms;

namespace {

const uint16_t PWM_TOP = sentinel::PWM_COUNTS - 1;  // 16 MHz / 800 = 20 kHz: above hearing, below the DRV8833's 50 kHz
const uint8_t TIMER_STANDS_3 = _BV(WGM33) | _BV(WGM32);  // fast PWM up to ICR (mode 14), no clock
const uint8_t TIMER_STANDS_4 = _BV(WGM43) | _BV(WGM42);

// High for `counts` of the period. 0 and all leave the timer: its narrowest pulse is one clock, not none.
inline void put(uint16_t counts, volatile uint8_t& tccr_a, uint8_t com, volatile uint16_t& ocr, volatile uint8_t& port, uint8_t bit) {
  if (counts == 0 || counts >= sentinel::PWM_COUNTS) {
    // First off the timer, then the level: its last edge must not come after it (bench_stop saw one in 80 in the emulator).
    tccr_a &= static_cast<uint8_t>(~com);
    if (counts == 0) {
      port &= static_cast<uint8_t>(~bit);
    } else {
      port |= bit;
    }
  } else {
    ocr = static_cast<uint16_t>(counts - 1);
    tccr_a |= com;
  }
}

inline void put_left(sentinel::Bridge bridge, int16_t speed) {
  const sentinel::BridgeInputs inputs = sentinel::bridge_inputs(bridge, speed, motors.slow_decay());
  put(inputs.in1, TCCR4A, _BV(COM4A1), OCR4A, PORTH, _BV(3));
  put(inputs.in2, TCCR4A, _BV(COM4B1), OCR4B, PORTH, _BV(4));
}

inline void put_right(sentinel::Bridge bridge, int16_t speed) {
  const sentinel::BridgeInputs inputs = sentinel::bridge_inputs(bridge, speed, motors.slow_decay());
  put(inputs.in1, TCCR3A, _BV(COM3A1), OCR3A, PORTE, _BV(3));
  put(inputs.in2, TCCR3A, _BV(COM3C1), OCR3C, PORTE, _BV(5));
}

}  // namespace

// Interrupts are off in here, and the UART holds three bytes (60 us) meanwhile: a test bounds what it takes.
// Coasting, the driver sleeps and the timers stand: two more switches between battery and motor. It falls asleep before
// its inputs change and wakes after, so that no order of the four inputs can jerk a motor.
ISR(TIMER2_COMPA_vect) {
  using sentinel::Bridge;
  static int16_t left = 0, right = 0;
  static Bridge bridge = Bridge::COAST;
  clock_ticks_ms = clock_ticks_ms + 1;
  if (clock_unfed_ms != 0xFF) clock_unfed_ms = clock_unfed_ms + 1;
  motors.tick();
  const Bridge next = motors.bridge();
  const bool turned = next != bridge;
  if (turned && next == Bridge::COAST) PORTG &= static_cast<uint8_t>(~_BV(5));
  if (turned || motors.left() != left) {
    left = motors.left();
    put_left(next, left);
  }
  if (turned || motors.right() != right) {
    right = motors.right();
    put_right(next, right);
  }
  if (!turned) return;
  bridge = next;
  const bool awake = next != Bridge::COAST;
  TCCR3B = awake ? TIMER_STANDS_3 | _BV(CS30) : TIMER_STANDS_3;
  TCCR4B = awake ? TIMER_STANDS_4 | _BV(CS40) : TIMER_STANDS_4;
  if (awake) PORTG |= _BV(5);
}

void motors_begin() {
  PORTH &= static_cast<uint8_t>(~(_BV(3) | _BV(4)));
  PORTE &= static_cast<uint8_t>(~(_BV(3) | _BV(5)));
  PORTG &= static_cast<uint8_t>(~_BV(5));
  DDRH |= _BV(3) | _BV(4);
  DDRE |= _BV(3) | _BV(5);
  DDRG |= _BV(5);
  DDRH &= static_cast<uint8_t>(~_BV(5));
  PORTH |= _BV(5);  // pull-up: FLT is open drain
  // Outputs off, timers without a clock until a motor runs.
  ICR3 = ICR4 = PWM_TOP;
  TCCR3A = _BV(WGM31);
  TCCR4A = _BV(WGM41);
  TCCR3B = TIMER_STANDS_3;
  TCCR4B = TIMER_STANDS_4;
  // 1 kHz: 16 MHz / 64 / 250, cleared on compare.
  TCCR2A = _BV(WGM21);
  TCCR2B = _BV(CS22);
  OCR2A = 249;
  TIMSK2 = _BV(OCIE2A);
}

bool motor_driver_fault() { return (PORTG & _BV(5)) != 0 && (PINH & _BV(5)) == 0; }
