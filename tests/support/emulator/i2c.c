/* The I2C side: connects the chip's model, gives the bus its 400 kHz, and can hold SDA low.
 *
 * simavr's TWI takes 1 us per bit whatever TWBR says and has no SDA line. So writes to TWCR pass through here: each is
 * delayed by what a byte takes longer at 2.5 us per bit, and swallowed while the bus is stuck. */
#include <simavr/avr_ioport.h>
#include <simavr/avr_twi.h>

#include "board.h"

enum { TWCR_ADDRESS = 0xBC, PIND_ADDRESS = 0x29, DDRD_ADDRESS = 0x2A };
enum { TWINT = 0x80, TWSTO = 0x10, TWEN = 0x04, SCL = 1, SDA = 2 };
static const avr_cycle_count_t EXTRA_CYCLES = 216; /* 9 bits of 1.5 us */
static const avr_cycle_count_t PULSE_CYCLES = 800; /* 50 us */

int bus_stuck_pulses = 0;
double last_ready_us = 0;

static avr_irq_t *twi_in, *int_pin;
static avr_io_write_t real_twcr_write, real_ddrd_write;
static avr_io_read_t real_pind_read;
static void *twcr_param, *ddrd_param, *pind_param;
static int delayed = 0;
static uint8_t delayed_value;
static int selected = 0, first_byte = 0;

static void on_message(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq;
  (void)param;
  avr_twi_msg_irq_t v;
  v.u.v = value;
  const uint8_t address = v.u.twi.addr;
  if (v.u.twi.msg & TWI_COND_STOP) selected = 0;
  if (v.u.twi.msg & TWI_COND_START) {
    selected = icm_selected(&chip, now_us(), address >> 1);
    first_byte = 1;
    if (selected) avr_raise_irq(twi_in, avr_twi_irq_msg(TWI_COND_ACK, address, 1));
  }
  if (!selected) return;
  if (v.u.twi.msg & TWI_COND_WRITE) {
    const int ok = chip.plugged && icm_write(&chip, now_us(), v.u.twi.data, first_byte);
    first_byte = 0;
    if (ok) avr_raise_irq(twi_in, avr_twi_irq_msg(TWI_COND_ACK, address, 1));
    i2c_schedule_sample();
  }
  if (v.u.twi.msg & TWI_COND_READ) {
    /* an open line reads as ones */
    const uint8_t byte = chip.plugged ? icm_read(&chip, now_us()) : 0xFF;
    avr_raise_irq(twi_in, avr_twi_irq_msg(TWI_COND_READ, address, byte));
  }
}

static avr_cycle_count_t forward(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)when;
  (void)param;
  if (delayed) {
    delayed = 0;
    real_twcr_write(a, TWCR_ADDRESS, delayed_value, twcr_param);
  }
  return 0;
}

static void on_twcr(struct avr_t *a, avr_io_addr_t address, uint8_t v, void *param) {
  (void)param;
  if (delayed) {
    avr_cycle_timer_cancel(a, forward, NULL);
    forward(a, 0, NULL);
  }
  if (!(v & TWEN)) {
    real_twcr_write(a, address, v, twcr_param);
  } else if (bus_stuck_pulses != 0) {
    a->data[address] = v; /* a stop bit stays set, an operation never ends */
  } else if ((v & TWINT) && !(v & TWSTO)) {
    delayed = 1;
    delayed_value = v;
    avr_cycle_timer_register(a, EXTRA_CYCLES, forward, NULL);
  } else {
    real_twcr_write(a, address, v, twcr_param);
  }
}

static uint8_t on_pind(struct avr_t *a, avr_io_addr_t address, void *param) {
  (void)param;
  uint8_t v = real_pind_read ? real_pind_read(a, address, pind_param) : a->data[address];
  v |= SCL | SDA; /* the breakout's pull-ups */
  if (bus_stuck_pulses != 0) v &= (uint8_t)~SDA;
  return v;
}

static void on_ddrd(struct avr_t *a, avr_io_addr_t address, uint8_t v, void *param) {
  (void)param;
  if (bus_stuck_pulses > 0 && !(a->data[address] & SCL) && (v & SCL)) {
    if (--bus_stuck_pulses == 0) event("bus released");
  }
  real_ddrd_write(a, address, v, ddrd_param);
}

static avr_cycle_count_t end_pulse(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)a;
  (void)when;
  (void)param;
  avr_raise_irq(int_pin, 0);
  return 0;
}

static avr_cycle_count_t on_sample(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)param;
  if (icm_next_us(&chip) > now_us() + 0.1) return 0;
  if (icm_sample(&chip)) {
    last_ready_us = now_us();
    avr_raise_irq(int_pin, 1);
    avr_cycle_timer_register(a, PULSE_CYCLES, end_pulse, NULL);
  }
  const double next = icm_next_us(&chip);
  if (next > 1e17) return 0;
  const avr_cycle_count_t cycle = (avr_cycle_count_t)(next * 16);
  return cycle > when ? cycle : when + 1;
}

void i2c_schedule_sample(void) {
  const double next = icm_next_us(&chip);
  avr_cycle_timer_cancel(avr, on_sample, NULL);
  if (next > 1e17) return;
  const double wait_us = next - now_us();
  avr_cycle_timer_register(avr, (avr_cycle_count_t)(wait_us > 1 ? wait_us * 16 : 16), on_sample, NULL);
}

void i2c_reset(void) {
  delayed = 0;
  selected = 0;
  avr_raise_irq(int_pin, 0);
  i2c_schedule_sample();
}

void i2c_attach(void) {
  twi_in = avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_INPUT);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_OUTPUT), on_message, NULL);
  int_pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('E'), 4);
  avr_raise_irq(int_pin, 0);
#define TAKE(ADDRESS, slot, saved, saved_param, mine)        \
  saved = avr->io[AVR_DATA_TO_IO(ADDRESS)].slot.c;           \
  saved_param = avr->io[AVR_DATA_TO_IO(ADDRESS)].slot.param; \
  avr->io[AVR_DATA_TO_IO(ADDRESS)].slot.c = mine;
  TAKE(TWCR_ADDRESS, w, real_twcr_write, twcr_param, on_twcr)
  TAKE(DDRD_ADDRESS, w, real_ddrd_write, ddrd_param, on_ddrd)
  TAKE(PIND_ADDRESS, r, real_pind_read, pind_param, on_pind)
}
