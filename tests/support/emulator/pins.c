/* Duty at the DRV8833's inputs, from pin edges, in windows of one millisecond (20 PWM periods). */
#include <simavr/avr_ioport.h>
#include <stdlib.h>

#include "board.h"

int duty_left = 0, duty_right = 0;

enum { LEFT_IN1, LEFT_IN2, RIGHT_IN1, RIGHT_IN2, SLEEP, PINS };
static const struct {
  char port;
  int bit;
} where[PINS] = {{'H', 3}, {'H', 4}, {'E', 3}, {'E', 5}, {'G', 5}};

static int level[PINS];
static int64_t sum[2];  /* cycles driven forward minus backward in this window */
static avr_cycle_count_t last_edge, window_start;
static FILE *log_file;

static int drive(int motor) {
  if (!level[SLEEP]) return 0;
  return level[2 * motor] - level[2 * motor + 1]; /* both high brakes, both low coasts */
}

static void integrate(void) {
  const int64_t passed = (int64_t)(avr->cycle - last_edge);
  for (int motor = 0; motor < 2; ++motor) sum[motor] += passed * drive(motor);
  last_edge = avr->cycle;
}

static void on_edge(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq;
  integrate();
  level[(intptr_t)param] = value & 1;
}

/* At each write to its port simavr sets an input to its pull-up, unless it was told of something stronger. */
void pin_drive(char port, int bit, int level) {
  avr_ioport_external_t outside = {.name = (unsigned)port, .mask = 1u << bit, .value = (unsigned)level << bit};
  avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(port), &outside);
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), bit), (uint32_t)level);
}

/* A reset clears what the firmware reads of a pin, and simavr sets it again only at a change. */
void pin_drive_anew(char port, int bit, int level) {
  pin_drive(port, bit, !level);
  pin_drive(port, bit, level);
}

static int driver_fault = 0;

void pins_driver_fault(int fault) {
  driver_fault = fault;
  pin_drive('H', 5, !fault);
}

void pins_reset(void) {
  pin_drive_anew('H', 5, !driver_fault);
  integrate();
  for (int i = 0; i < PINS; ++i) level[i] = 0; /* a pin in reset floats, and the driver pulls its inputs down */
}

void pins_window(void) {
  integrate();
  const int64_t length = (int64_t)(avr->cycle - window_start);
  window_start = avr->cycle;
  if (length == 0) return;
  const int left = (int)((sum[0] * 1000 + (sum[0] > 0 ? length / 2 : -length / 2)) / length);
  const int right = (int)((sum[1] * 1000 + (sum[1] > 0 ? length / 2 : -length / 2)) / length);
  sum[0] = sum[1] = 0;
  if (left == duty_left && right == duty_right) return;
  duty_left = left;
  duty_right = right;
  if (log_file) {
    fprintf(log_file, "%.0f %d %d\n", now_us(), left, right);
  } else if (!options.out) {
    event("pins %d %d", left, right);
  }
}

static void servo_edge(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq;
  static avr_cycle_count_t rise[2];
  static int width[2];
  const int i = (int)(intptr_t)param;
  if (value & 1) {
    rise[i] = avr->cycle;
    return;
  }
  const int us = (int)((avr->cycle - rise[i] + 8) / 16);
  if (rise[i] && abs(us - width[i]) > 1) event("servo %d %d", i, us);
  width[i] = us;
}

void pins_attach(void) {
  for (intptr_t i = 0; i < PINS; ++i) {
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(where[i].port), where[i].bit), on_edge, (void *)i);
  }
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 5), servo_edge, (void *)0);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), 6), servo_edge, (void *)1);
  if (options.pins) log_file = fopen(options.pins, "w");
}
