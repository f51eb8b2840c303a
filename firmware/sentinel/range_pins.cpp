// The HC-SR04's two wires. Timer 5 notes by itself when ECHO changes (input capture), however late the interrupt comes.
#include <avr/interrupt.h>
#include <util/delay.h>

#include "board.h"
#include "range.h"

extern sentinel::RangeFinder range_finder;

static const uint8_t TRIG = _BV(0), ECHO = _BV(1);  // port L, which no interrupt writes

// Two a measurement at most: a rise, then a fall, then none until range_listen().
ISR(TIMER5_CAPT_vect) {
  const uint16_t at = ICR5;
  const uint16_t ago = static_cast<uint16_t>(TCNT5 - at);  // half microseconds
  if (range_finder.edge(clock_us_in_isr() - (ago >> 1))) {
    TCCR5B &= static_cast<uint8_t>(~_BV(ICES5));
    TIFR5 = _BV(ICF5);  // turning the edge may count as one
  } else {
    TIMSK5 &= static_cast<uint8_t>(~_BV(ICIE5));
  }
}

void range_begin() {
  DDRL |= TRIG;
  PORTL |= ECHO;  // pull-up: a wire that ends nowhere is high, and no echo
  TCCR5B |= _BV(ICNC5);  // four clocks at one level, or it is noise
}

void range_listen() {
  TCCR5B |= _BV(ICES5);
  TIFR5 = _BV(ICF5);
  TIMSK5 |= _BV(ICIE5);
}

void range_sound() {
  PORTL |= TRIG;
  _delay_us(12);  // it asks for 10
  PORTL &= static_cast<uint8_t>(~TRIG);
}

bool range_echo_is_high() { return (PINL & ECHO) != 0; }
