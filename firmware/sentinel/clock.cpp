// Timer 5 counts half microseconds; its overflows extend it to 32 bits of microseconds (wrap after 71.6 minutes).
#include <avr/interrupt.h>
#include <util/atomic.h>

#include "board.h"

// Not static: the emulator's test of the wrap sets it.
volatile uint32_t clock_overflows = 0;
volatile uint32_t clock_ticks_ms = 0;
volatile uint8_t clock_unfed_ms __attribute__((section(".noinit")));  // read after a reset

ISR(TIMER5_OVF_vect) { clock_overflows = clock_overflows + 1; }

void clock_begin() {
  TIMSK0 = 0;  // the Arduino core's millis() is not used; its interrupt would only delay ours
  TCCR5A = 0;
  TCCR5B = _BV(CS51);  // 16 MHz / 8
  TIMSK5 = _BV(TOIE5);
}

uint32_t clock_us_in_isr() {
  uint16_t ticks = TCNT5;
  uint32_t overflows = clock_overflows;
  // An overflow that happened with interrupts off is not counted yet.
  if ((TIFR5 & _BV(TOV5)) && ticks < 0x8000) ++overflows;
  return overflows << 15 | ticks >> 1;
}

uint32_t clock_us() {
  uint32_t now;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = clock_us_in_isr(); }
  return now;
}

uint32_t clock_ms() {
  uint32_t now;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = clock_ticks_ms; }
  return now;
}
