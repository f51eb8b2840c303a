/* UART 0: to a pty, or to a file while a script feeds it. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <simavr/avr_uart.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include "board.h"

double corrupt_rate = 0;
double least_delay_us = 1e9; /* from data ready to an IMU frame's last byte */
uint64_t bytes_out, bytes_lost, bytes_in;

enum { QUEUE = 1 << 16 };
static const avr_cycle_count_t BYTE_CYCLES = 352; /* 11 bits at 500 kBd, as simavr counts */
static uint8_t queue[QUEUE];
static unsigned head, tail;
static int feeding = 0, xoff = 0;
static avr_irq_t *uart_in;
static FILE *out_file;
static int master = -1;
static int opened = 0; /* somebody has the pty's other end */

static uint8_t maybe_corrupt(uint8_t byte) {
  if (corrupt_rate > 0 && random_unit() < corrupt_rate) byte ^= (uint8_t)(1 + (int)(random_unit() * 255));
  return byte;
}

static void on_output(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq;
  (void)param;
  const uint8_t byte = maybe_corrupt((uint8_t)value);
  ++bytes_out;
  static int length = 0;
  ++length;
  if ((uint8_t)value == 0) {
    if (length == 37 && now_us() - last_ready_us < least_delay_us) least_delay_us = now_us() - last_ready_us;
    length = 0;
  }
  if (out_file) {
    fputc(byte, out_file);
    return;
  }
  if (master < 0 || !opened) {
    ++bytes_lost;
    return;
  }
  while (write(master, &byte, 1) != 1) {
    /* A real line does not wait for its reader; unpaced virtual time does, so that a slow test loses nothing. */
    if (errno != EAGAIN || options.realtime) {
      ++bytes_lost;
      return;
    }
    struct pollfd p = {master, POLLOUT, 0};
    poll(&p, 1, 100);
    if (p.revents & (POLLHUP | POLLERR)) return;
  }
}

static void on_xon(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq;
  (void)value;
  xoff = (int)(intptr_t)param;
}

static avr_cycle_count_t feed(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)a;
  (void)param;
  if (head == tail) {
    feeding = 0;
    return 0;
  }
  if (!xoff) {
    avr_raise_irq(uart_in, maybe_corrupt(queue[tail]));
    tail = (tail + 1) % QUEUE;
    ++bytes_in;
  }
  return when + BYTE_CYCLES;
}

void serial_send(const uint8_t *bytes, int count) {
  for (int i = 0; i < count; ++i) {
    if ((head + 1) % QUEUE == tail) return;
    queue[head] = bytes[i];
    head = (head + 1) % QUEUE;
  }
  if (!feeding && count > 0) {
    feeding = 1;
    avr_cycle_timer_register(avr, BYTE_CYCLES, feed, NULL);
  }
}

void serial_reset(void) {
  head = tail = 0;
  feeding = xoff = 0;
}

static void open_pty(void) {
  int slave;
  struct termios raw;
  memset(&raw, 0, sizeof raw);
  cfmakeraw(&raw);
  char name[256];
  if (openpty(&master, &slave, name, &raw, NULL) != 0) {
    perror("openpty");
    exit(2);
  }
  fcntl(master, F_SETFL, O_NONBLOCK);
  close(slave); /* from now on a hang-up tells that nobody has it open */
  unlink(options.pty);
  if (symlink(name, options.pty) != 0) {
    perror(options.pty);
    exit(2);
  }
  opened = 0;
}

void serial_close(void) {
  if (master >= 0) close(master);
  master = -1;
  if (options.pty) unlink(options.pty);
  if (out_file) fclose(out_file);
  out_file = NULL;
}

void serial_plug(int plugged) {
  if (!options.pty) return;
  if (plugged && master < 0) open_pty();
  if (!plugged) serial_close();
  event("serial %s", plugged ? "plugged" : "unplugged");
}

/* Says when a drive (0x10) or stop (0x11) frame has come: a frame's second byte is its type, which is never zero. */
static void watch_frames(const uint8_t *bytes, ssize_t n) {
  static int length = 0;
  static uint8_t type = 0;
  for (ssize_t i = 0; i < n; ++i) {
    if (bytes[i] == 0) {
      if (length > 1 && (type == 0x10 || type == 0x11)) event("in %02x", type);
      length = 0;
    } else if (++length == 2) {
      type = bytes[i];
    }
  }
}

void serial_poll(void) {
  if (master < 0) return;
  struct pollfd p = {master, POLLIN, 0};
  poll(&p, 1, 0);
  const int now_open = !(p.revents & POLLHUP);
  if (now_open && !opened) {
    event("serial opened, reset by DTR");
    board_reset();
  }
  opened = now_open;
  if (p.revents & POLLIN) {
    uint8_t bytes[1024];
    const ssize_t n = read(master, bytes, sizeof bytes);
    if (n > 0) {
      watch_frames(bytes, n);
      serial_send(bytes, (int)n);
    }
  }
}

void serial_attach(void) {
  uint32_t flags = 0; /* neither echo to stdout nor sleep when polled */
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_output, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), on_xon, (void *)0);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), on_xon, (void *)1);
  if (options.out) out_file = fopen(options.out, "wb");
  if (options.pty) open_pty();
}
