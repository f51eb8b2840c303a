// Pan-tilt servos on timer 1 (50 Hz, no interrupts) and the battery's divider on A0.
#include "board.h"

void servos_begin() {
  DDRB |= _BV(5) | _BV(6);
  ICR1 = 39999;  // 20 ms in half microseconds
  TCCR1A = _BV(WGM11);
  TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS11);
}

void servos_set(uint16_t pan_us, uint16_t tilt_us) {
  uint8_t outputs = _BV(WGM11);
  if (pan_us != 0) {
    OCR1A = static_cast<uint16_t>(2 * pan_us - 1);
    outputs |= _BV(COM1A1);
  }
  if (tilt_us != 0) {
    OCR1B = static_cast<uint16_t>(2 * tilt_us - 1);
    outputs |= _BV(COM1B1);
  }
  TCCR1A = outputs;
}

void adc_begin() {
  ADMUX = _BV(REFS1) | _BV(REFS0);  // internal 2.56 V: the 5 V rail of a power bank sags with the motors
  ADCSRB = 0;
  ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0) | _BV(ADSC);  // 125 kHz
}

bool adc_poll(uint16_t* battery_mv) {
  if (ADCSRA & _BV(ADSC)) return false;
  const uint16_t counts = ADC;
  ADCSRA |= _BV(ADSC);
  *battery_mv = static_cast<uint16_t>(static_cast<uint32_t>(counts) * BATTERY_FULL_SCALE_MV / 1023);
  return true;
}
