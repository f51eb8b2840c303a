#include "stack.h"

#include <avr/io.h>

extern uint8_t _end;      // of .bss and .noinit
extern uint8_t __stack;   // top of RAM

const uint8_t PAINT = 0xC5;

// Before .data and .bss are set, nothing but registers may be used.
extern "C" void __attribute__((naked, used, section(".init1"))) stack_paint() {
  __asm volatile(
      "    ldi r30, lo8(_end)\n"
      "    ldi r31, hi8(_end)\n"
      "    ldi r24, 0xC5\n"
      "    ldi r25, hi8(__stack)\n"
      "    rjmp 2f\n"
      "1:  st Z+, r24\n"
      "2:  cpi r30, lo8(__stack)\n"
      "    cpc r31, r25\n"
      "    brlo 1b\n"
      "    breq 1b\n" ::);
}

uint16_t stack_free() {
  static const uint8_t* at = &_end;
  static uint16_t free_bytes = 0xFFFF;
  for (uint8_t i = 0; i < 32; ++i, ++at) {
    if (*at != PAINT) {
      free_bytes = static_cast<uint16_t>(at - &_end);
      at = &_end;
      break;
    }
  }
  return free_bytes;
}
