#include "board.h"
#ifndef SENTINEL_DMP  // Wire has the bus then
#include "twi_bus.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>
#include <util/twi.h>

namespace {

const uint32_t TIMEOUT_US = 5000;  // the longest operation takes 0.7 ms
const uint8_t SCL = _BV(0), SDA = _BV(1);  // port D

enum class Phase : uint8_t { IDLE, BUSY, DONE, FAILED };

volatile Phase phase = Phase::IDLE;
sentinel::BusOp op;
volatile uint8_t at = 0;
uint8_t data[sentinel::IMU_BURST];
uint32_t started_us = 0;
uint16_t recoveries = 0;

const uint8_t GO = _BV(TWINT) | _BV(TWEN) | _BV(TWIE);

void end(Phase result) {
  TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
  phase = result;
}

// A slave that lost count in the middle of a byte holds SDA; nine clocks let it finish (NXP UM10204, section 3.1.16).
void recover() {
  TWCR = 0;
  PORTD &= static_cast<uint8_t>(~(SCL | SDA));
  DDRD &= static_cast<uint8_t>(~(SCL | SDA));
  for (uint8_t i = 0; i < 9 && (PIND & SDA) == 0; ++i) {
    DDRD |= SCL;
    _delay_us(5);
    DDRD &= static_cast<uint8_t>(~SCL);
    _delay_us(5);
  }
  // Stop condition: SDA rises while SCL is high.
  DDRD |= SDA;
  _delay_us(5);
  DDRD &= static_cast<uint8_t>(~SDA);
  _delay_us(5);
  ++recoveries;
  bus_begin();
}

}  // namespace

ISR(TWI_vect) {
  if (phase != Phase::BUSY) {
    TWCR = _BV(TWINT) | _BV(TWEN);
    return;
  }
  switch (TW_STATUS) {
    case TW_START:
      at = 0;
      TWDR = static_cast<uint8_t>(op.address << 1 | TW_WRITE);
      TWCR = GO;
      break;
    case TW_MT_SLA_ACK:
    case TW_MT_DATA_ACK:
      if (at < op.write_length) {
        TWDR = op.write[at];
        at = at + 1;
        TWCR = GO;
      } else if (op.read_length != 0) {
        TWCR = GO | _BV(TWSTA);
      } else {
        end(Phase::DONE);
      }
      break;
    case TW_REP_START:
      at = 0;
      TWDR = static_cast<uint8_t>(op.address << 1 | TW_READ);
      TWCR = GO;
      break;
    case TW_MR_DATA_ACK:
      data[at] = TWDR;
      at = at + 1;
      // fall through
    case TW_MR_SLA_ACK:
      TWCR = at + 1 < op.read_length ? GO | _BV(TWEA) : GO;  // the last byte is not acknowledged
      break;
    case TW_MR_DATA_NACK:
      data[at] = TWDR;
      end(Phase::DONE);
      break;
    default:  // no acknowledge, arbitration lost, bus error
      end(Phase::FAILED);
      break;
  }
}

void bus_begin() {
  PORTD |= SCL | SDA;  // weak pull-ups beside the breakout's own
  TWSR = 0;
  TWBR = 12;  // 16 MHz / (16 + 2 * 12) = 400 kHz
  TWCR = _BV(TWEN);
  phase = Phase::IDLE;
}

bool bus_idle() { return phase == Phase::IDLE && (TWCR & _BV(TWSTO)) == 0; }

void bus_start(const sentinel::BusOp& next, uint32_t now_us) {
  op = next;
  started_us = now_us;
  phase = Phase::BUSY;
  TWCR = GO | _BV(TWSTA);
}

bool bus_finished(uint32_t now_us, bool* ok) {
  const Phase now = phase;
  if (now == Phase::DONE || now == Phase::FAILED) {
    // An end that the bus never executes shows as a stop bit that stays.
    if ((TWCR & _BV(TWSTO)) != 0 && now_us - started_us < TIMEOUT_US) return false;
    if ((TWCR & _BV(TWSTO)) != 0) recover();
    *ok = now == Phase::DONE;
    phase = Phase::IDLE;
    return true;
  }
  if (now == Phase::BUSY && now_us - started_us >= TIMEOUT_US) {
    recover();
    *ok = false;
    return true;
  }
  return false;
}

bool bus_has_result() { return phase == Phase::DONE || phase == Phase::FAILED; }
const uint8_t* bus_data() { return data; }
uint16_t bus_recoveries() { return recoveries; }
#endif
