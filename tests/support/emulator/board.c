/* Emulated board of the Sentinel robot: an ATmega2560 (libsimavr) runs the real ELF; an ICM-20948 hangs on its I2C, an HC-SR04
 * on two pins, its UART ends in a pty or a file, and its motor pins are decoded into duty. Test-only; libsimavr is GPL-3, so
 * is this program's binary, and nothing else links to it.
 *
 *   board --elf F --out F --script F --seconds S [--pins F]     batch: virtual time only, bit-identical runs
 *                                                               [--boot HEX: starts there, as a stock Mega does]
 *   board --elf F --pty LINK [--realtime]                        live: commands on stdin, events on stdout
 */
#include <fcntl.h>
#include <getopt.h>
#include <poll.h>
#include <simavr/avr_adc.h>
#include <simavr/avr_extint.h>
#include <simavr/avr_ioport.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_hex.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "board.h"

avr_t *avr;
struct icm chip;
struct options options;

static const int FREQUENCY = 16000000;
static const double UNMEASURED = -1;
static const uint64_t SLIP_NS = 20000000;
static int quit = 0;
static int want_reset = 0;
static int resets = -1; /* the first is power on */
static void (*core_reset)(struct avr_t *);
static uint8_t *patched_at = NULL, patched[2];
static int want_hang = 0; /* 1: interrupts on, 2: off */
static double interrupts_off_us = UNMEASURED; /* longest stretch since the command of this name */
static uint64_t start_wall_ns;
static uint64_t late_max_ns;
static FILE *script;
static double script_us;
static char script_line[8192];
static uint64_t rng = 88172645463325252ull;

double now_us(void) { return (double)avr->cycle / 16.0; }

uint64_t wall_ns(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (uint64_t)t.tv_sec * 1000000000ull + (uint64_t)t.tv_nsec;
}

double random_unit(void) {
  rng ^= rng << 13;
  rng ^= rng >> 7;
  rng ^= rng << 17;
  return (double)(rng >> 11) / 9007199254740992.0;
}

/* Between instructions only: simavr would go on inside the one it is at. */
void board_reset(void) { want_reset = 1; }

void event(const char *format, ...) {
  va_list args;
  va_start(args, format);
  printf("E %.0f %llu ", now_us(), (unsigned long long)(options.out ? 0 : wall_ns()));
  vprintf(format, args);
  putchar('\n');
  if (!options.out) fflush(stdout);
  va_end(args);
}

/* A firmware that hangs: the instruction it stands at becomes a jump to itself, until the next reset. */
static void try_hang(void) {
  if (!want_hang || patched_at || !avr->sreg[S_I]) return;
  patched_at = avr->flash + avr->pc;
  memcpy(patched, patched_at, 2);
  patched_at[0] = 0xFF;
  patched_at[1] = 0xCF; /* rjmp .-2 */
  if (want_hang == 2) avr->sreg[S_I] = 0;
  if (avr->state == cpu_Sleeping) avr->state = cpu_Running;
  event("hung, interrupts %s", want_hang == 1 ? "on" : "off");
  want_hang = 0;
}

static void adc(int mv) {
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0), (uint32_t)(mv * 33 / 133));
}

static int hex_bytes(const char *hex, uint8_t *out) {
  int n = 0;
  unsigned byte;
  while (sscanf(hex, "%2x", &byte) == 1) {
    out[n++] = (uint8_t)byte;
    hex += 2;
  }
  return n;
}

static void command(const char *line) {
  char word[32] = "", rest[8100] = "";
  sscanf(line, "%31s %8099[^\n]", word, rest);
  const double number = atof(rest);
  if (!strcmp(word, "uart")) {
    uint8_t bytes[4096];
    serial_send(bytes, hex_bytes(rest, bytes));
  } else if (!strcmp(word, "imu_unplug")) {
    chip.plugged = 0;
  } else if (!strcmp(word, "imu_plug")) {
    chip.plugged = 1;
    icm_power_on(&chip, now_us());
  } else if (!strcmp(word, "imu_address")) {
    chip.address = (uint8_t)strtol(rest, NULL, 16);
  } else if (!strcmp(word, "imu_ppm")) {
    chip.clock_ppm = number;
  } else if (!strcmp(word, "mag_present")) {
    chip.mag_present = (int)number;
  } else if (!strcmp(word, "sample")) {
    double v[9] = {0};
    const int n = sscanf(rest, "%lf %lf %lf %lf %lf %lf %lf %lf %lf", v, v + 1, v + 2, v + 3, v + 4, v + 5, v + 6, v + 7, v + 8);
    chip.pattern = 0;
    memcpy(chip.accel, v, sizeof chip.accel);
    memcpy(chip.gyro, v + 3, sizeof chip.gyro);
    if (n == 9) memcpy(chip.mag, v + 6, sizeof chip.mag);
  } else if (!strcmp(word, "bus_stuck")) {
    bus_stuck_pulses = (int)number;
  } else if (!strcmp(word, "corrupt")) {
    corrupt_rate = number;
  } else if (!strcmp(word, "serial")) {
    serial_plug((int)number);
  } else if (!strcmp(word, "battery")) {
    adc((int)number);
  } else if (!strcmp(word, "driver_fault")) {
    pins_driver_fault(number != 0);
  } else if (!strcmp(word, "range")) {
    range_command(rest);
  } else if (!strcmp(word, "hang")) {
    want_hang = strcmp(rest, "off") ? 1 : 2;
  } else if (!strcmp(word, "reset")) {
    board_reset();
  } else if (!strcmp(word, "poke")) {
    unsigned address;
    char hex[64];
    if (sscanf(rest, "%x %63s", &address, hex) == 2) hex_bytes(hex, avr->data + address);
  } else if (!strcmp(word, "interrupts_off")) {
    interrupts_off_us = 0;
  } else if (!strcmp(word, "mark")) {
    event("mark %s", rest);
  } else if (!strcmp(word, "quit")) {
    quit = 1;
  } else if (word[0] && word[0] != '#') {
    fprintf(stderr, "board: unknown command: %s\n", word);
    quit = 2;
  }
}

static void read_script(void) {
  while (script && now_us() >= script_us) {
    if (script_line[0]) command(script_line);
    script_line[0] = 0;
    char line[8192];
    int used = 0;
    if (!fgets(line, sizeof line, script)) {
      fclose(script);
      script = NULL;
      return;
    }
    if (sscanf(line, "%lf %n", &script_us, &used) == 1) strcpy(script_line, line + used);
  }
}

static void read_stdin(void) {
  static char buffer[16384];
  static size_t used = 0;
  struct pollfd p = {0, POLLIN, 0};
  if (poll(&p, 1, 0) <= 0) return;
  const ssize_t n = read(0, buffer + used, sizeof buffer - used - 1);
  if (n <= 0) {
    quit = 1; /* whoever started us has gone */
    return;
  }
  used += (size_t)n;
  buffer[used] = 0;
  char *line = buffer, *newline;
  while ((newline = strchr(line, '\n')) != NULL) {
    *newline = 0;
    command(line);
    line = newline + 1;
  }
  used = strlen(line);
  memmove(buffer, line, used + 1);
  if (used + 1 >= sizeof buffer) used = 0;
}

static avr_cycle_count_t each_millisecond(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)param;
  /* simavr would poll every low INT pin at every cycle, also those that are motor or bus pins; a reset brings that back */
  for (uint8_t i = 0; i < EXTINT_COUNT; ++i) avr_extint_set_strict_lvl_trig(avr, i, 0);
  pins_window();
  try_hang();
  if (options.pty) {
    read_stdin();
    serial_poll();
  }
  if (options.realtime) {
    const uint64_t due = start_wall_ns + (uint64_t)(now_us() * 1000);
    const uint64_t now = wall_ns();
    if (due > now) {
      const struct timespec t = {0, (long)(due - now)};
      nanosleep(&t, NULL);
    } else {
      if (now - due > late_max_ns) late_max_ns = now - due;
      if (now - due > SLIP_NS) {
        /* This PC was too busy: say so and go on from here. Hurrying to catch up would shorten every time that follows. */
        event("slip %llu", (unsigned long long)((now - due) / 1000000));
        start_wall_ns += now - due;
      }
    }
  }
  if (options.seconds > 0 && now_us() >= options.seconds * 1e6) quit = 1;
  (void)a;
  return when + (avr_cycle_count_t)(FREQUENCY / 1000);
}

static avr_cycle_count_t each_script_step(struct avr_t *a, avr_cycle_count_t when, void *param) {
  (void)a;
  (void)param;
  read_script();
  return script ? when + 160 : 0; /* 10 us */
}

/* A reset of the MCU drops every timer of simavr, ours too. */
static void start_timers(void) {
  if (script) avr_cycle_timer_register(avr, 160, each_script_step, NULL);
  avr_cycle_timer_register(avr, (avr_cycle_count_t)(FREQUENCY / 1000), each_millisecond, NULL);
  i2c_reset();
  serial_reset();
  range_reset();
}

static void on_reset(struct avr_t *a) {
  if (patched_at) {
    memcpy(patched_at, patched, 2);
    patched_at = NULL;
  }
  if (core_reset) core_reset(a);
  pins_reset();
  start_timers();
  if (++resets > 0) event("reset %d", resets);
}

static void no_sleep(struct avr_t *a, avr_cycle_count_t cycles) {
  (void)a;
  (void)cycles;
}

/* Resets begin in the bootloader then. */
static int load_bootloader(void) {
  ihex_chunk_p chunks = NULL;
  const int count = read_ihex_chunks(options.boot, &chunks);
  if (count <= 0) return 0;
  avr->reset_pc = chunks[0].baseaddr;
  for (int i = 0; i < count; ++i) memcpy(avr->flash + chunks[i].baseaddr, chunks[i].data, chunks[i].size);
  avr->codeend = avr->flashend;
  free_ihex_chunks(chunks);
  return 1;
}

static void parse_options(int argc, char **argv) {
  static const struct option known[] = {{"elf", 1, 0, 'e'},     {"out", 1, 0, 'o'},      {"script", 1, 0, 's'}, {"pty", 1, 0, 'p'},
                                        {"pins", 1, 0, 'i'},    {"boot", 1, 0, 'b'},    {"seconds", 1, 0, 't'},  {"realtime", 0, 0, 'r'},
                                        {0, 0, 0, 0}};
  int c;
  while ((c = getopt_long(argc, argv, "", known, NULL)) != -1) {
    switch (c) {
      case 'e': options.elf = optarg; break;
      case 'b': options.boot = optarg; break;
      case 'o': options.out = optarg; break;
      case 's': options.script = optarg; break;
      case 'p': options.pty = optarg; break;
      case 'i': options.pins = optarg; break;
      case 't': options.seconds = atof(optarg); break;
      case 'r': options.realtime = 1; break;
      default: exit(2);
    }
  }
  if (!options.elf || (!options.out && !options.pty)) {
    fprintf(stderr, "board: needs --elf FILE and --out FILE or --pty LINK\n");
    exit(2);
  }
}

static int painted_bytes(void) {
  /* firmware/sentinel/stack.cpp paints free RAM with 0xC5: the longest such run is what no stack ever reached */
  int best = 0, run = 0;
  for (int i = 0x200; i <= avr->ramend; ++i) {
    run = avr->data[i] == 0xC5 ? run + 1 : 0;
    if (run > best) best = run;
  }
  return best;
}

/* simavr comes back after at most 16 cycles, and at once when interrupts go on. */
static void watch_interrupts(void) {
  static avr_cycle_count_t off_since = 0;
  if (avr->sreg[S_I]) {
    const double us = (double)(avr->cycle - off_since) / 16.0;
    if (off_since != 0 && interrupts_off_us >= 0 && us > interrupts_off_us) interrupts_off_us = us;
    off_since = 0;
  } else if (off_since == 0) {
    off_since = avr->cycle;
  }
}

int main(int argc, char **argv) {
  parse_options(argc, argv);
  elf_firmware_t firmware;
  memset(&firmware, 0, sizeof firmware);
  if (elf_read_firmware(options.elf, &firmware) != 0) return 2;
  avr = avr_make_mcu_by_name("atmega2560");
  if (!avr) return 2;
  avr_init(avr);
  avr->log = LOG_ERROR;
  avr_load_firmware(avr, &firmware);
  if (options.boot && !load_bootloader()) return 2;
  avr->frequency = FREQUENCY;
  avr->vcc = avr->avcc = avr->aref = 5000;
  avr->run_cycle_limit = 16;
  avr->sleep = no_sleep;

  chip.address = 0x69;
  chip.plugged = chip.mag_present = chip.pattern = 1;
  chip.mag[0] = 20;
  chip.mag[2] = -40;
  icm_power_on(&chip, 0);
  core_reset = avr->reset;
  avr->reset = on_reset;
  i2c_attach();
  pins_attach();
  range_attach();
  serial_attach();
  if (options.script) {
    script = fopen(options.script, "r");
    if (!script) {
      perror(options.script);
      return 2;
    }
  }
  avr_reset(avr);
  pins_driver_fault(0);
  adc(7400);
  start_wall_ns = wall_ns();
  if (options.pty) {
    event("ready");
    fcntl(0, F_SETFL, O_NONBLOCK);
  }
  while (!quit) {
    if (want_reset) avr_reset(avr);
    want_reset = 0;
    const int state = avr_run(avr);
    watch_interrupts();
    if (state == cpu_Done || state == cpu_Crashed) {
      event("firmware ended in state %d", state);
      quit = 3;
    }
  }
  printf("{\"virtual_s\": %.6f, \"samples\": %llu, \"bytes_out\": %llu, \"bytes_in\": %llu, \"bytes_lost\": %llu, \"resets\": %d, "
         "\"stack_free\": %d, \"left\": %d, \"right\": %d, \"late_max_ms\": %.1f, \"least_delay_us\": %.0f, "
         "\"interrupts_off_us\": %.1f, \"measurements\": %llu}\n",
         now_us() / 1e6, (unsigned long long)chip.samples, (unsigned long long)bytes_out, (unsigned long long)bytes_in,
         (unsigned long long)bytes_lost, resets, painted_bytes(), duty_left, duty_right, (double)late_max_ns / 1e6, least_delay_us,
         interrupts_off_us, (unsigned long long)range_measurements());
  serial_close();
  return quit == 1 ? 0 : quit;
}
