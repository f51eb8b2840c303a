/* An HC-SR04 at TRIG (PL0) and ECHO (PL1). Times as its makers' sheets and copies of it have them. Its wire ECHO is
 * plugged in only where a command said so: until then the Mega's own pull-up holds it. */
#include <simavr/avr_ioport.h>
#include <stdlib.h>
#include <string.h>

#include "board.h"

static const double BURST_US = 450;      /* from TRIG's fall until ECHO rises */
static const double NO_ECHO_US = 38000;  /* so long ECHO is high when nothing comes back */
static const double SHORTEST_TRIG_US = 10;

static enum { UNPLUGGED, WORKS, MUTE, STUCK, RINGS } state = UNPLUGGED;
static double echo_us = 0, no_echo_us = 0;
static double trig_rose_us = 0;
static int sounds = 0;
static uint64_t measurements = 0;

static void echo(int level) { pin_drive('L', 1, level); }
static int rests_at(void) { return state == UNPLUGGED || state == STUCK; }
static avr_cycle_count_t cycles(double us) { return (avr_cycle_count_t)(us * 16); }

static avr_cycle_count_t fall(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)a; (void)when; (void)param;
  sounds = 0;
  echo(rests_at());
  return 0;
}

static avr_cycle_count_t rise(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)a; (void)param;
  if (state != WORKS) return 0;
  ++measurements;
  echo(1);
  const double reach_us = no_echo_us > 0 ? no_echo_us : NO_ECHO_US;
  /* From the cycle that this was meant for: simavr comes late by an instruction. */
  avr_cycle_timer_register(avr, cycles(echo_us > 0 ? echo_us : reach_us) - (avr->cycle - when), fall, NULL);
  return 0;
}

/* A wire that catches the motors' 20 kHz. */
static avr_cycle_count_t ring(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)a; (void)param;
  static int level = 0;
  if (state != RINGS) return 0;
  echo(level ^= 1);
  return when + cycles(25);
}

static void on_trig(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq; (void)param;
  if (value & 1) {
    trig_rose_us = now_us();
  } else if (now_us() - trig_rose_us < SHORTEST_TRIG_US) {
    event("trig too short: %.1f us", now_us() - trig_rose_us);
  } else if (state == WORKS && !sounds) {
    sounds = 1;
    avr_cycle_timer_register(avr, cycles(BURST_US), rise, NULL);
  }
}

void range_command(const char *rest) {
  char word[16] = "";
  double number = 0;
  sscanf(rest, "%15s %lf", word, &number);
  if (!strcmp(word, "echo")) { /* us there and back; 0: nothing in reach */
    state = WORKS;
    echo_us = number;
  } else if (!strcmp(word, "copy")) { /* us that ECHO is high when nothing comes back */
    no_echo_us = number;
  } else if (!strcmp(word, "mute")) {
    state = MUTE;
  } else if (!strcmp(word, "stuck")) {
    state = STUCK;
  } else if (!strcmp(word, "unplug")) {
    state = UNPLUGGED;
  } else if (!strcmp(word, "rings")) {
    state = RINGS;
    avr_cycle_timer_register(avr, cycles(25), ring, NULL);
  }
  if (!sounds) echo(rests_at());
}

uint64_t range_measurements(void) { return measurements; }

/* simavr drops timers at a reset, and with them an echo on its way. */
void range_reset(void) {
  sounds = 0;
  if (state == RINGS) avr_cycle_timer_register(avr, cycles(25), ring, NULL);
  pin_drive_anew('L', 1, rests_at());
}

void range_attach(void) { avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('L'), 0), on_trig, NULL); }
