#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "ring_buffer.h"

namespace {

sentinel::RingBuffer<128> input;
sentinel::RingBuffer<256> output;  // six IMU packets: 5 ms of line time
volatile uint16_t overruns = 0;

}  // namespace

ISR(USART0_RX_vect) {
  if (UCSR0A & _BV(DOR0)) overruns = overruns + 1;
  const uint8_t byte = UDR0;
  if (!input.push(byte)) overruns = overruns + 1;
}

ISR(USART0_UDRE_vect) {
  uint8_t byte;
  if (output.pop(&byte)) {
    UDR0 = byte;
  } else {
    UCSR0B &= static_cast<uint8_t>(~_BV(UDRIE0));
  }
}

void uart_begin() {
  UBRR0 = 3;  // 16 MHz / 8 / 4 = 500 kBd exactly
  UCSR0A = _BV(U2X0);
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

bool uart_read(uint8_t* byte) { return input.pop(byte); }

bool uart_send(const uint8_t* data, uint8_t length, uint8_t spare) {
  if (output.room() < length + spare) return false;
  for (uint8_t i = 0; i < length; ++i) output.push(data[i]);
  const uint8_t sreg = SREG;
  cli();
  UCSR0B |= _BV(UDRIE0);
  SREG = sreg;
  return true;
}

bool uart_has_input() { return !input.empty(); }

uint16_t uart_overruns() {
  const uint8_t sreg = SREG;
  cli();
  const uint16_t n = overruns;
  SREG = sreg;
  return n;
}
