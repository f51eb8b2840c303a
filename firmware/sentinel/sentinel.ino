// Firmware of the Sentinel robot for an Arduino Mega 2560: IMU at 225 Hz, motors with a watchdog, pan-tilt, battery.
// docs/firmware.md tells the story; thinking is in ../core, pins and interrupts in the files beside this one.
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "board.h"
#ifdef SENTINEL_DMP
#include "dmp.h"
#endif
#include "imu.h"
#include "motor_pins.h"
#include "motors.h"
#include "protocol.h"
#include "range.h"
#include "stack.h"
#include "twi_bus.h"
#include "uart.h"

using namespace sentinel;

static const uint8_t FIRMWARE_MAJOR = 2, FIRMWARE_MINOR = 1;
static const uint16_t STATUS_PERIOD_MS = 100, HELLO_PERIOD_MS = 1000;

static Icm20948 imu;
sentinel::RangeFinder range_finder;
static FrameParser parser;
static bool greeted = false;  // the Pi has spoken since the reset
static uint16_t tx_dropped = 0;
static uint16_t loop_max_us = 0;
static uint16_t battery_mv = 0;

// Survives a reset: the start-up code leaves .noinit alone.
static uint8_t reset_cause __attribute__((section(".noinit")));
static uint16_t boot_id __attribute__((section(".noinit")));
static uint16_t ran_before __attribute__((section(".noinit")));
static const uint16_t RAN = 0x5EA7;  // RAM after power on is anything
static const uint8_t HUNG_MS = 100;  // the watchdog's 120 ms, less what its own oscillator may be fast

// Runs before main(): after a watchdog reset the watchdog is still on, at its shortest period.
extern "C" void __attribute__((naked, used, section(".init3"))) keep_reset_cause() {
  reset_cause = MCUSR;
  MCUSR = 0;
  wdt_disable();
}

#ifdef SENTINEL_DMP
static const uint16_t DMP_PERIOD_MS = 5;  // its FIFO is asked so often; the DMP computes 55 quaternions a second
static bool dmp_runs = false;
static bool imu_runs() { return dmp_runs; }
static bool mag_runs() { return true; }  // not asked for
static bool imu_has_work() { return false; }
static uint16_t bus_recoveries_seen() { return 0; }
#else
// The sample's time is that of this interrupt's start: 2 us after the pin, up to 40 us when another interrupt runs (a test bounds that).
ISR(INT4_vect) { imu.data_ready(clock_us_in_isr()); }

static bool imu_runs() { return imu.running(); }
static bool mag_runs() { return imu.mag_present(); }
static bool imu_has_work() { return bus_has_result() || imu.sample_waits(); }
static uint16_t bus_recoveries_seen() { return bus_recoveries(); }
#endif

// What must stay free on the line for what matters more: samples come first, then the status, then answers. A sample's room
// is free again before the next one comes: 133 bytes leave in 2.7 ms, the shortest period.
static const uint8_t SAMPLE = 0, REPORT = 37, ANSWER = 134;  // a sample; a sample, a status, a range and a sample

static bool send(const uint8_t* payload, uint8_t length, uint8_t spare) {
  uint8_t frame[MAX_FRAME];
  const bool sent = uart_send(frame, encode_frame(payload, length, frame), spare);
  if (!sent) ++tx_dropped;
  return sent;
}

static void send_hello() {
  const ConfigImu& c = imu.config();
  uint8_t payload[MAX_PAYLOAD];
  send(payload, pack(Hello{PROTOCOL_VERSION, FIRMWARE_MAJOR, FIRMWARE_MINOR, reset_cause, imu.address(), imu.who(), c.gyro_scale,
                           c.accel_scale, c.gyro_filter, c.accel_filter, c.divider, boot_id},
                     payload),
       ANSWER);
}

static void send_ack(uint8_t asked, Result result) {
  uint8_t payload[MAX_PAYLOAD];
  send(payload, pack_ack(asked, result, payload), ANSWER);
}

static void send_status(uint32_t now_ms) {
  Status s = Status();
  s.uptime_ms = now_ms;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    s.samples = imu.samples();
    s.samples_lost = imu.lost();
    s.left = motors.left();
    s.right = motors.right();
    s.ttl_stops = motors.ttl_stops();
    if (motors.driving()) s.flags |= FLAG_DRIVING;
    if (motors.ttl_stop()) s.flags |= FLAG_TTL_STOP;
    if (motors.low_battery()) s.flags |= FLAG_LOW_BATTERY;
  }
  if (!imu_runs()) s.flags |= FLAG_IMU_MISSING;
  if (imu_runs() && !mag_runs()) s.flags |= FLAG_MAG_MISSING;
  if (imu.errors() != 0 && now_ms - imu.last_error_ms() < 1000) s.flags |= FLAG_BUS_ERROR;
  if (motor_driver_fault()) s.flags |= FLAG_DRIVER_FAULT;
  s.bus_errors = imu.errors();
  s.bus_recoveries = bus_recoveries_seen();
  s.imu_starts = imu.starts();
  s.rx_frames = parser.frames();
  s.rx_bad = parser.bad();
  s.rx_overruns = uart_overruns();
  s.tx_dropped = tx_dropped;
  s.battery_mv = battery_mv;
  s.loop_max_us = loop_max_us;
  s.stack_free = stack_free();
  loop_max_us = 0;
  uint8_t payload[MAX_PAYLOAD];
  send(payload, pack(s, payload), REPORT);
}

static void handle(const uint8_t* payload, uint8_t length) {
  const uint8_t* body = payload + 1;
  const uint8_t n = length - 1;
  Result result = Result::DONE;
  switch (static_cast<Type>(payload[0])) {
    case Type::DRIVE: {
      Drive drive;
      result = parse(body, n, &drive);
      if (result != Result::DONE) break;
      bool is_taken = false;
      if (drive.boot_id == boot_id) {
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { is_taken = motors.command(drive, clock_ms()); }
      }
      if (is_taken) return;  // twenty a second: not acknowledged, the status shows them
      result = Result::TOO_LATE;
      break;
    }
    case Type::STOP:
      ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { motors.stop(); }
      break;
    case Type::ASK_TIME: {
      if (n != 4) {
        result = Result::BAD_LENGTH;
        break;
      }
      uint8_t out[MAX_PAYLOAD];
      send(out, pack_time(read_u32(body), clock_us(), out), ANSWER);
      return;
    }
    case Type::ASK_HELLO:
      send_hello();
      return;
    case Type::CONFIG_IMU: {
      ConfigImu config;
      result = parse(body, n, &config);
      if (result == Result::DONE) imu.configure(config);
      break;
    }
    case Type::CONFIG_MOTORS: {
      ConfigMotors config;
      result = parse(body, n, &config);
      if (result != Result::DONE) break;
      ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { motors.configure(config); }
      break;
    }
    case Type::SERVO: {
      Servo servo;
      result = parse(body, n, &servo);
      if (result == Result::DONE) servos_set(servo.pan_us, servo.tilt_us);
      break;
    }
    case Type::CONFIG_RANGE: {
      ConfigRange config;
      result = parse(body, n, &config);
      if (result != Result::DONE) break;
      ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { range_finder.configure(config); }
      break;
    }
    default:
      result = Result::UNKNOWN_TYPE;
      break;
  }
  send_ack(payload[0], result);
}

#ifdef SENTINEL_DMP
// Wire waits for each transfer (0.7 ms): the motors do not, their interrupt is not masked meanwhile.
static void serve_imu(uint32_t now_ms, uint32_t now_us) {
  static uint32_t last_ms = 0, sequence = 0;
  int32_t q_wxyz[4];
  if (!dmp_runs || now_ms - last_ms < DMP_PERIOD_MS) return;
  last_ms = now_ms;
  if (!dmp_read(q_wxyz)) return;
  uint8_t payload[MAX_PAYLOAD];
  send(payload, pack_quaternion(sequence++, now_us, q_wxyz, payload), SAMPLE);
}
#else
static void serve_imu(uint32_t now_ms, uint32_t now_us) {
  bool ok;
  if (bus_finished(now_us, &ok)) imu.done(now_ms, ok, bus_data());
  BusOp op;
  if (bus_idle() && imu.next(now_ms, &op)) bus_start(op, now_us);
  ImuPacket packet;
  if (imu.take(&packet)) {
    uint8_t payload[MAX_PAYLOAD];
    if (send(payload, pack(packet, payload), SAMPLE)) imu.count_sent();
  }
}

#endif

static void serve_range(uint32_t now_ms, uint32_t now_us) {
  if (!range_finder.is_on()) return;  // the block below delays a sample's stamp by 3 us where it hits it
  bool asks = false, has_ended = false;
  RangePacket packet;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    asks = range_finder.next(now_ms, now_us, range_echo_is_high());
    if (asks) range_listen();  // in this block: the end of an echo that was given up would count as the next one's begin
    has_ended = range_finder.take(&packet);
  }
  if (asks) range_sound();
  if (!has_ended) return;
  uint8_t payload[MAX_PAYLOAD];
  send(payload, pack(packet, payload), REPORT);
}

void setup() {
  ++boot_id;
  // The stock bootloader clears MCUSR; that the loop stood while the motors' interrupt counted tells of the watchdog.
  if (reset_cause == 0 && ran_before == RAN && clock_unfed_ms >= HUNG_MS) reset_cause = _BV(WDRF);
  ran_before = RAN;
  clock_unfed_ms = 0;
  motors_begin();
  clock_begin();
  uart_begin();
  servos_begin();
  adc_begin();
  range_begin();
#ifdef SENTINEL_DMP
  sei();
  dmp_runs = dmp_begin();  // takes a second, before the AVR's watchdog is on; the motors are off
#else
  bus_begin();
  EICRB |= _BV(ISC41) | _BV(ISC40);  // rising edge
  EIMSK |= _BV(INT4);
#endif
  wdt_enable(WDTO_120MS);
  set_sleep_mode(SLEEP_MODE_IDLE);
  const uint8_t delimiter = 0;  // ends what the reset or the bootloader left half said, or it would swallow the hello
  uart_send(&delimiter, 1, 0);
  send_hello();
}

void loop() {
  static uint32_t last_tick = 0, last_status_ms = 0, last_hello_ms = 0;
  const uint32_t start_us = clock_us();
  const uint32_t now_ms = clock_ms();

  // Feeding depends on both: this loop running, and the motors' interrupt alive.
  if (now_ms != last_tick) {
    last_tick = now_ms;
    wdt_reset();
    clock_unfed_ms = 0;
  }
  // One frame per turn at most, so that a flood on the line cannot hold the IMU up.
  uint8_t byte;
  while (uart_read(&byte)) {
    if (parser.feed(byte)) {
      greeted = true;
      handle(parser.payload(), parser.length());
      break;
    }
  }
  serve_imu(now_ms, start_us);
  serve_range(now_ms, start_us);
  if (adc_poll(&battery_mv)) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { motors.battery(battery_mv); }
  }
  if (now_ms - last_status_ms >= STATUS_PERIOD_MS) {
    last_status_ms = now_ms;
    send_status(now_ms);
  } else {
    stack_free();
  }
  // Unasked, so that the Pi need not write while the bootloader listens: one byte would keep it from starting us.
  if (!greeted && now_ms - last_hello_ms >= HELLO_PERIOD_MS) {
    last_hello_ms = now_ms;
    send_hello();
  }
  const uint16_t took_us = static_cast<uint16_t>(clock_us() - start_us);
  if (took_us > loop_max_us) loop_max_us = took_us;

  // Sleep until the next interrupt, unless one has left work since: on an AVR the instruction after sei() still runs first.
  cli();
  if (!uart_has_input() && !imu_has_work() && clock_ms() == last_tick) {
    sleep_enable();
    sei();
    sleep_cpu();
    sleep_disable();
  }
  sei();
}
