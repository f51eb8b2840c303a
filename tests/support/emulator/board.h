/* The emulated Mega: what its parts share. */
#pragma once
#include <simavr/sim_avr.h>
#include <stdint.h>
#include <stdio.h>

#include "icm20948.h"

struct options {
  const char *elf, *boot, *out, *script, *pty, *pins;
  double seconds;
  int realtime;
};

extern avr_t *avr;
extern struct icm chip;
extern struct options options;

double now_us(void);
uint64_t wall_ns(void);
void board_reset(void);
void event(const char *format, ...); /* one line on stdout: E virtual_us wall_ns text */

/* i2c.c */
extern int bus_stuck_pulses; /* clocks until the slave lets SDA go; 0: free, negative: never */
extern double last_ready_us;
void i2c_attach(void);
void i2c_schedule_sample(void);
void i2c_reset(void); /* after the MCU's */

/* serial.c */
extern double corrupt_rate, least_delay_us;
void serial_attach(void);
void serial_send(const uint8_t *bytes, int count); /* to the Mega */
void serial_poll(void);
void serial_reset(void);
void serial_plug(int plugged);
void serial_close(void);
extern uint64_t bytes_out, bytes_lost, bytes_in;

/* pins.c */
void pins_attach(void);
void pins_reset(void);
void pins_window(void); /* once per millisecond */
void pins_driver_fault(int fault);
void pin_drive(char port, int bit, int level); /* one pin of a port that something outside holds */
void pin_drive_anew(char port, int bit, int level); /* after the MCU's reset */
extern int duty_left, duty_right;

/* range.c */
void range_attach(void);
void range_reset(void); /* after the MCU's */
void range_command(const char *rest);
uint64_t range_measurements(void);

double random_unit(void);
