// Unit tests of firmware/core on a PC. Usage: test_core path/to/serial_frames.txt; prints one line per test.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include "../core/cobs.h"
#include "../core/crc16.h"
#include "../core/imu.h"
#include "../core/motors.h"
#include "../core/protocol.h"
#include "../core/range.h"
#include "../core/ring_buffer.h"

using namespace sentinel;

static int failures = 0;
#define CHECK(condition)                                                      \
  do {                                                                        \
    if (!(condition)) {                                                       \
      if (++failures > 20) std::exit(1);                                        \
      std::printf("  FAILED %s:%d: %s\n", __FILE__, __LINE__, #condition);    \
    }                                                                         \
  } while (0)

typedef std::vector<uint8_t> Bytes;

static Bytes from_hex(const std::string& hex) {
  Bytes out;
  for (size_t i = 0; i + 1 < hex.size(); i += 2) out.push_back(static_cast<uint8_t>(std::stoi(hex.substr(i, 2), nullptr, 16)));
  return out;
}

static Bytes frame_of(const Bytes& payload) {
  uint8_t out[MAX_FRAME];
  const uint8_t n = encode_frame(payload.data(), static_cast<uint8_t>(payload.size()), out);
  return Bytes(out, out + n);
}

struct Golden {
  Bytes payload, frame;
};
static std::map<std::string, Golden> golden;

static void load_golden(const char* path) {
  std::ifstream file(path);
  std::string name, payload, frame;
  while (file >> name >> payload >> frame) golden[name] = Golden{from_hex(payload), from_hex(frame)};
}

static Bytes packed(const std::string& name) {
  uint8_t out[MAX_PAYLOAD];
  uint8_t n = 0;
  if (name == "hello") {
    n = pack(Hello{2, 2, 0, 8, 0x69, 0xEA, 1, 1, 3, 3, 4, 513}, out);
  } else if (name == "imu") {
    ImuPacket p = {7, 0xFFFFFFF0u, 0x11, {}};
    for (uint8_t i = 0; i < IMU_BURST; ++i) p.burst[i] = i;
    n = pack(p, out);
  } else if (name == "status") {
    n = pack(Status{70000, 0x41, 99, 1, 2, 3, 4, 5, 6, 7, 8, 9, 7400, -1000, 1000, 120, 6000}, out);
  } else if (name == "ack") {
    n = pack_ack(0x14, Result::BAD_VALUE, out);
  } else if (name == "mega_time") {
    n = pack_time(0xDEADBEEFu, 1, out);
  } else if (name == "range") {
    n = pack(RangePacket{65535, 0xFFFFFFF0u, 5831, Echo::HEARD}, out);
  } else if (name == "range_none") {
    n = pack(RangePacket{1, 2, 0, Echo::NONE}, out);
  }
  return Bytes(out, out + n);
}

static void test_crc_of_the_check_string() {
  CHECK(crc16(reinterpret_cast<const uint8_t*>("123456789"), 9) == 0x29B1);
}

static void test_packed_messages_equal_the_golden_bytes() {
  CHECK(golden.size() == 16);
  for (const char* name : {"hello", "imu", "status", "ack", "mega_time", "range", "range_none"}) CHECK(packed(name) == golden[name].payload);
}

static void test_frames_equal_the_golden_bytes_and_parse_back() {
  for (const auto& item : golden) {
    CHECK(frame_of(item.second.payload) == item.second.frame);
    FrameParser parser;
    bool whole = false;
    for (uint8_t byte : item.second.frame) whole = parser.feed(byte);
    CHECK(whole);
    CHECK(Bytes(parser.payload(), parser.payload() + parser.length()) == item.second.payload);
  }
}

static void test_golden_commands_parse_to_their_values() {
  const auto body = [](const char* name) { return golden[name].payload.data() + 1; };
  const auto size = [](const char* name) { return static_cast<uint8_t>(golden[name].payload.size() - 1); };
  Drive drive;
  CHECK(parse(body("drive"), size("drive"), &drive) == Result::DONE);
  CHECK(drive.left == -1000 && drive.right == 250 && drive.until_ms == 70300 && drive.boot_id == 513);
  ConfigImu imu;
  CHECK(parse(body("config_imu"), size("config_imu"), &imu) == Result::DONE);
  CHECK(imu.gyro_scale == 3 && imu.accel_scale == 0 && imu.gyro_filter == 7 && imu.accel_filter == 1 && imu.divider == 9);
  ConfigMotors motors;
  CHECK(parse(body("config_motors"), size("config_motors"), &motors) == Result::DONE);
  CHECK(motors.slow_decay == 1 && motors.ramp_up == 4 && motors.ramp_down == 10 && motors.cutoff_mv == 6400);
  Servo servo;
  CHECK(parse(body("servo"), size("servo"), &servo) == Result::DONE);
  CHECK(servo.pan_us == 1500 && servo.tilt_us == 0);
  ConfigRange range;
  CHECK(parse(body("config_range"), size("config_range"), &range) == Result::DONE && range.period_ms == 100);
}

static void test_commands_out_of_range_are_refused() {
  Drive drive;
  Bytes body(golden["drive"].payload.begin() + 1, golden["drive"].payload.end());
  const uint8_t size = static_cast<uint8_t>(body.size());
  CHECK(parse(body.data(), static_cast<uint8_t>(size - 1), &drive) == Result::BAD_LENGTH);
  body.back() ^= 1;  // the inverted copy disagrees
  CHECK(parse(body.data(), size, &drive) == Result::BAD_VALUE);
  Bytes fast = {0xE9, 0x03, 0, 0, 100, 0, 0, 0, 1, 0};  // 1001 permille
  for (int i = 0; i < 10; ++i) fast.push_back(static_cast<uint8_t>(~fast[static_cast<size_t>(i)]));
  CHECK(parse(fast.data(), 20, &drive) == Result::BAD_VALUE);
  Servo servo;
  const uint8_t beyond[4] = {0xC5, 0x09, 0, 0};  // 2501 us
  CHECK(parse(beyond, 4, &servo) == Result::BAD_VALUE);
  ConfigRange range;
  const uint8_t periods[4] = {0, 49, 250, 251};
  CHECK(parse(periods, 1, &range) == Result::DONE && parse(periods + 1, 1, &range) == Result::BAD_VALUE);
  CHECK(parse(periods + 2, 1, &range) == Result::DONE && parse(periods + 3, 1, &range) == Result::BAD_VALUE);
  CHECK(parse(periods, 2, &range) == Result::BAD_LENGTH);
}

static void test_damage_costs_one_frame_and_an_overlong_one_is_dropped() {
  FrameParser parser;
  Bytes stream = golden["stop"].frame;
  stream[1] ^= 0x40;
  Bytes noise(400, 0x55);
  stream.insert(stream.end(), noise.begin(), noise.end());
  stream.push_back(0);
  stream.insert(stream.end(), golden["ask_time"].frame.begin(), golden["ask_time"].frame.end());
  int whole = 0;
  for (uint8_t byte : stream) whole += parser.feed(byte);
  CHECK(whole == 1 && parser.bad() == 2 && parser.payload()[0] == 0x12);
}

static void test_cobs_keeps_every_length_and_zero_pattern() {
  for (uint8_t length = 0; length < 100; ++length) {
    for (uint8_t period = 1; period < 12; ++period) {
      Bytes data;
      for (uint8_t i = 0; i < length; ++i) data.push_back(i % period == 0 ? 0 : i);
      Bytes code(length + 1u);
      CHECK(cobs_encode(data.data(), length, code.data()) == length + 1);
      for (uint8_t byte : code) CHECK(byte != 0);
      CHECK(cobs_decode(code.data(), static_cast<uint8_t>(length + 1)) == length);
      CHECK(Bytes(code.begin(), code.begin() + length) == data);
    }
  }
}

static void test_ring_buffer_keeps_order_and_refuses_when_full() {
  RingBuffer<8> ring;
  uint8_t byte = 0;
  CHECK(!ring.pop(&byte) && ring.room() == 7);
  for (int round = 0; round < 50; ++round) {
    for (uint8_t i = 0; i < 7; ++i) CHECK(ring.push(i));
    CHECK(!ring.push(99) && ring.room() == 0);
    for (uint8_t i = 0; i < 7; ++i) CHECK(ring.pop(&byte) && byte == i);
  }
  CHECK(ring.empty());
  RingBuffer<256> big;
  for (int i = 0; i < 255; ++i) CHECK(big.push(static_cast<uint8_t>(i)));
  CHECK(!big.push(1) && big.used() == 255);
}

static void run(MotorControl& motors, int ms) {
  for (int i = 0; i < ms; ++i) motors.tick();
}

static const uint16_t BOOT_ID = 1;  // looked at where commands come in, not here

// A command made now that ends so much later.
static void drive(MotorControl& motors, int16_t left, int16_t right, uint32_t ttl_ms) {
  motors.command(Drive{left, right, ttl_ms, BOOT_ID}, 0);
}

static void test_a_command_lives_from_when_it_was_made_however_late_it_comes() {
  const uint32_t now_ms = 0xFFFFFF00;  // the uptime wraps within the command's life
  MotorControl motors;
  CHECK(motors.command(Drive{1000, 1000, now_ms + 300, BOOT_ID}, now_ms + 250));
  run(motors, 49);
  CHECK(motors.driving() && motors.left() > 0);
  run(motors, 1);
  CHECK(!motors.driving() && motors.left() == 0);
}

static void test_what_comes_after_its_end_neither_starts_motors_nor_keeps_them_running() {
  const Drive late{1000, 1000, 5000, BOOT_ID};
  for (const uint32_t now_ms : {5000u, 5001u, 7000u, 5000u + 0x7FFFFFFFu, 5000u - MAX_AHEAD_MS - 1}) {
    MotorControl resting;
    CHECK(!resting.command(late, now_ms));
    run(resting, 5);
    CHECK(!resting.driving() && resting.left() == 0 && resting.bridge() == Bridge::COAST);
    MotorControl moving;
    CHECK(moving.command(Drive{500, 500, now_ms + 300, BOOT_ID}, now_ms));
    run(moving, 200);
    CHECK(!moving.command(late, now_ms));
    run(moving, 99);
    CHECK(moving.left() == 500);
    run(moving, 1);
    CHECK(moving.left() == 0 && moving.ttl_stops() == 1);
  }
}

static void test_motors_are_off_until_a_command_and_stop_when_commands_go_silent() {
  MotorControl motors;
  run(motors, 1000);
  CHECK(motors.left() == 0 && motors.bridge() == Bridge::COAST);
  drive(motors, 1000, -1000, 300);
  CHECK(motors.left() == 0);  // only tick moves
  run(motors, 299);
  CHECK(motors.left() == 1000 && motors.right() == -1000 && motors.driving());
  run(motors, 1);
  CHECK(motors.left() == 0 && motors.right() == 0 && motors.bridge() == Bridge::BRAKE);
  CHECK(motors.ttl_stop() && motors.ttl_stops() == 1);
  run(motors, BRAKE_MS);
  CHECK(motors.bridge() == Bridge::COAST);
  run(motors, 5000);
  CHECK(motors.left() == 0 && motors.ttl_stops() == 1);
}

static void test_time_to_live_has_an_upper_bound() {
  MotorControl motors;
  drive(motors, 500, 500, MAX_AHEAD_MS);
  run(motors, MAX_TTL_MS - 1);
  CHECK(motors.left() == 500);
  run(motors, 1);
  CHECK(motors.left() == 0);
}

static void test_stop_is_at_once_and_a_fresh_command_is_needed() {
  MotorControl motors;
  drive(motors, 800, 800, 300);
  run(motors, 250);
  motors.stop();
  CHECK(motors.left() == 0 && motors.right() == 0);
  run(motors, 1000);
  CHECK(motors.left() == 0 && !motors.ttl_stop());
}

static void test_speed_ramps_and_reverses_through_zero() {
  MotorControl motors;
  int16_t before = 0;
  for (int ms = 0; ms < 2000; ++ms) {
    if (ms % 100 == 0) drive(motors, static_cast<int16_t>(ms < 1000 ? 1000 : -1000), 300, 300);
    motors.tick();
    const int change = motors.left() - before;
    CHECK(change <= 10 && change >= -10);
    if (before > 0) CHECK(motors.left() >= 0);
    before = motors.left();
  }
  CHECK(motors.left() == -1000 && motors.right() == 300);
}

static void test_low_battery_holds_the_motors_off_until_it_recovers() {
  MotorControl motors;
  motors.configure(ConfigMotors{1, 4, 10, 6400});
  motors.battery(6300);
  for (int i = 0; i < 19; ++i) {  // shorter than the grace period: a start-up dip
    drive(motors, 500, 500, 300);
    run(motors, 100);
  }
  CHECK(motors.left() == 500 && !motors.low_battery());
  run(motors, 200);
  CHECK(motors.low_battery() && motors.left() == 0);
  motors.battery(6500);  // within the hysteresis
  drive(motors, 500, 500, 300);
  run(motors, 50);
  CHECK(motors.left() == 0);
  motors.battery(6800);
  run(motors, 1);
  drive(motors, 500, 500, 300);
  run(motors, 200);
  CHECK(motors.left() == 500 && !motors.low_battery());
}

static void test_a_repeated_configuration_keeps_an_empty_battery_empty() {
  MotorControl motors;
  motors.configure(ConfigMotors{1, 4, 10, 6400});
  motors.battery(6000);
  run(motors, 1500);
  motors.configure(ConfigMotors{1, 4, 10, 6400});  // nor does it start the grace period anew
  run(motors, 600);
  CHECK(motors.low_battery());
  motors.configure(ConfigMotors{0, 8, 20, 6400});
  drive(motors, 500, 500, 300);
  run(motors, 100);
  CHECK(motors.low_battery() && motors.left() == 0);
  motors.configure(ConfigMotors{1, 4, 10, 5000});
  CHECK(!motors.low_battery());
}

static void test_bridge_inputs_follow_the_driver_s_truth_table() {
  const auto is = [](BridgeInputs b, int in1, int in2) { return b.in1 == in1 && b.in2 == in2; };  // of 800 counts
  CHECK(is(bridge_inputs(Bridge::COAST, 700, true), 0, 0));
  CHECK(is(bridge_inputs(Bridge::BRAKE, 700, false), 800, 800));
  CHECK(is(bridge_inputs(Bridge::RUN, 700, true), 800, 240));
  CHECK(is(bridge_inputs(Bridge::RUN, -700, true), 240, 800));
  CHECK(is(bridge_inputs(Bridge::RUN, 700, false), 560, 0));
  CHECK(is(bridge_inputs(Bridge::RUN, -700, false), 0, 560));
  CHECK(is(bridge_inputs(Bridge::RUN, 0, true), 800, 800));
}

static void test_every_duty_has_its_counts_in_both_decays() {
  for (int16_t permille = 0; permille <= FULL; ++permille) {
    const uint16_t counts = static_cast<uint16_t>(permille * 800L / 1000);
    CHECK(pwm_counts(static_cast<uint16_t>(permille)) == counts);
    CHECK((counts == PWM_COUNTS) == (permille == FULL));
    for (int16_t speed : {permille, static_cast<int16_t>(-permille)}) {
      const BridgeInputs fast = bridge_inputs(Bridge::RUN, speed, false), slow = bridge_inputs(Bridge::RUN, speed, true);
      const int driven = speed < 0 ? -counts : counts;
      CHECK(fast.in1 - fast.in2 == driven && slow.in1 - slow.in2 == driven);
      CHECK(fast.in1 <= PWM_COUNTS && fast.in2 <= PWM_COUNTS && slow.in1 <= PWM_COUNTS && slow.in2 <= PWM_COUNTS);
    }
  }
}

// A chip that answers like the ICM-20948: enough registers for the set-up and the burst.
struct FakeChip {
  uint8_t address = 0x69;
  bool present = true, mag = true;
  uint8_t bank = 0;
  std::map<int, uint8_t> registers;
  int resets = 0;

  bool transfer(const BusOp& op, uint8_t* data) {
    if (!present || op.address != address) return false;
    const uint8_t reg = op.write[0];
    if (op.write_length == 2) {
      if (reg == 0x7F) {
        bank = op.write[1] >> 4;
      } else if (bank == 0 && reg == 0x06 && op.write[1] & 0x80) {
        registers.clear();
        bank = 0;
        ++resets;
      } else {
        registers[bank << 8 | reg] = op.write[1];
      }
    }
    for (uint8_t i = 0; i < op.read_length; ++i) data[i] = static_cast<uint8_t>(i + 1);
    if (op.read_length == 1 && bank == 0 && reg == 0x00) data[0] = 0xEA;
    if (op.read_length == 1 && bank == 0 && reg == 0x17) data[0] = mag ? 0x40 : 0x50;
    return true;
  }
};

static void bus(Icm20948& imu, FakeChip& chip, uint32_t from_ms, uint32_t to_ms, bool ready = false) {
  uint8_t data[IMU_BURST];
  for (uint32_t now = from_ms; now < to_ms; ++now) {
    if (ready && chip.present && now % 4 == 0) imu.data_ready(now * 1000);
    BusOp op;
    while (imu.next(now, &op)) imu.done(now, chip.transfer(op, data), data);
  }
}

static void test_imu_set_up_leaves_the_registers_as_meant() {
  Icm20948 imu;
  FakeChip chip;
  bus(imu, chip, 0, 300);  // shorter than set-up plus the silence that starts it again
  CHECK(imu.running() && imu.address() == 0x69 && imu.mag_present() && imu.starts() == 1 && chip.resets == 1);
  CHECK(chip.registers[0x200] == 4 && chip.registers[0x201] == 0x1B && chip.registers[0x211] == 4);
  CHECK(chip.registers[0x214] == 0x1B && chip.registers[0x209] == 1 && chip.registers[0x00F] == 0x10);
  CHECK(chip.registers[0x011] == 1 && chip.registers[0x303] == 0x8C && chip.registers[0x305] == 0x89 && chip.bank == 0);
}

static void test_imu_is_found_at_its_other_address_and_without_magnetometer() {
  Icm20948 imu;
  FakeChip chip;
  chip.address = 0x68;
  chip.mag = false;
  bus(imu, chip, 0, 400);
  CHECK(imu.running() && imu.address() == 0x68 && !imu.mag_present());
}

static void test_every_data_ready_gives_one_packet_with_its_own_stamp() {
  Icm20948 imu;
  FakeChip chip;
  bus(imu, chip, 0, 300);  // shorter than set-up plus the silence that starts it again
  uint8_t data[IMU_BURST];
  ImuPacket packet;
  for (uint32_t i = 0; i < 100; ++i) {
    imu.data_ready(5000 + i);
    BusOp op;
    CHECK(imu.next(300 + i, &op) && op.read_length == IMU_BURST);
    imu.done(300 + i, chip.transfer(op, data), data);
    CHECK(imu.take(&packet) && packet.sequence == i && packet.t_us == 5000 + i && packet.scales == 0x11);
    CHECK(packet.burst[0] == 1 && packet.burst[22] == 23 && !imu.take(&packet));
  }
  imu.data_ready(1);
  imu.data_ready(2);  // the first was never read: its number is missing
  BusOp op;
  CHECK(imu.next(500, &op));
  imu.done(500, chip.transfer(op, data), data);
  CHECK(imu.take(&packet) && packet.sequence == 101 && packet.t_us == 2);
}

static void test_imu_comes_back_after_it_was_unplugged() {
  Icm20948 imu;
  FakeChip chip;
  bus(imu, chip, 0, 1000, true);
  CHECK(imu.running());
  chip.present = false;
  bus(imu, chip, 1000, 2000, true);
  CHECK(!imu.running() && imu.errors() > 0 && imu.address() == 0);
  chip.present = true;
  chip.registers.clear();
  chip.bank = 2;
  bus(imu, chip, 2000, 3000, true);
  CHECK(imu.running() && imu.starts() == 2 && chip.registers[0x201] == 0x1B);
}

static void test_imu_that_falls_silent_is_set_up_again() {
  Icm20948 imu;
  FakeChip chip;
  bus(imu, chip, 0, 1000, true);
  bus(imu, chip, 1000, 2000, false);  // acknowledges, but no data-ready: it lost its set-up
  CHECK(imu.starts() >= 2);
}

static void test_imu_takes_new_scales_and_rate() {
  Icm20948 imu;
  FakeChip chip;
  bus(imu, chip, 0, 500, true);
  imu.configure(ConfigImu{3, 2, 1, 5, 9});
  bus(imu, chip, 500, 1000, true);
  CHECK(imu.running() && chip.registers[0x200] == 9 && chip.registers[0x201] == (1 << 3 | 3 << 1 | 1));
  CHECK(chip.registers[0x214] == (5 << 3 | 2 << 1 | 1));
}

// One operation, begun and not ended: false while there is none.
static bool begin(Icm20948& imu, uint32_t& now, uint32_t until, BusOp* op) {
  for (; now < until; ++now) {
    if (imu.next(now, op)) return true;
  }
  return false;
}

static void test_imu_settings_come_while_any_operation_is_on_the_bus() {
  // The n-th operation is on the bus when they come; there are some 60 until it runs, with bursts after.
  for (int n = 0; n < 100; ++n) {
    Icm20948 imu;
    FakeChip chip;
    uint8_t data[IMU_BURST];
    uint32_t now = 0;
    BusOp op;
    for (int i = 0; i <= n; ++i) {
      if (imu.running()) imu.data_ready(now * 1000);
      CHECK(begin(imu, now, 10000, &op));
      if (i == n) imu.configure(ConfigImu{3, 2, 1, 5, 9});
      const bool ok = chip.transfer(op, data);
      if (op.read_length == IMU_BURST) data[0] = 0;  // read as a WHO_AM_I it would be wrong
      imu.done(now, ok, data);
      ImuPacket packet;
      if (imu.take(&packet)) CHECK(packet.scales == 0x11);  // those it was measured with
    }
    bus(imu, chip, now, now + 400, true);
    CHECK(imu.running() && imu.errors() == 0);
    CHECK(chip.registers[0x200] == 9 && chip.registers[0x201] == (1 << 3 | 3 << 1 | 1));
    CHECK(chip.registers[0x214] == (5 << 3 | 2 << 1 | 1) && chip.registers[0x303] == 0x8C);
  }
}

// A chip that was set up, and its samples one by one.
struct RunningImu {
  Icm20948 imu;
  FakeChip chip;
  uint8_t data[IMU_BURST];
  BusOp op;
  ImuPacket packet;

  RunningImu() { bus(imu, chip, 0, 300); }

  // Reads the sample that waits. True when that gives a packet.
  bool read(uint32_t now_ms) {
    if (!imu.next(now_ms, &op)) return false;
    imu.done(now_ms, chip.transfer(op, data), data);
    return imu.take(&packet);
  }
};

static void test_every_sample_is_sent_or_counted_as_lost() {
  RunningImu running;
  Icm20948& imu = running.imu;
  const auto sample = [&](bool room) {
    imu.data_ready(1);
    CHECK(imu.lost() == 0 || !room);
    CHECK(running.read(300));
    if (room) imu.count_sent();
  };
  sample(true);
  CHECK(imu.samples() == 1 && imu.lost() == 0);
  sample(false);  // the line was full
  CHECK(imu.samples() == 2 && imu.lost() == 1);
  imu.data_ready(1);
  imu.data_ready(2);  // one was never read, one waits
  CHECK(imu.samples() == 4 && imu.lost() == 2);
  CHECK(imu.next(300, &running.op));
  CHECK(imu.lost() == 2);
  imu.done(300, false, running.data);  // no acknowledge
  CHECK(imu.lost() == 3);
}

static void test_each_set_up_anew_leaves_a_hole_in_the_numbers() {
  RunningImu running;
  Icm20948& imu = running.imu;
  for (uint32_t start = 0; start < 3; ++start) {
    if (start > 0) bus(imu, running.chip, 400 * start, 400 * start + 300);
    CHECK(imu.running() && imu.starts() == start + 1);
    imu.data_ready(1);
    CHECK(running.read(400 * start + 300) && running.packet.sequence == 2 * start);
    imu.count_sent();
    CHECK(imu.lost() == start);
    imu.configure(ConfigImu{3, 2, 1, 5, static_cast<uint8_t>(9 + start)});
  }
}

static void test_a_sample_that_comes_during_a_burst_makes_it_uncertain_and_lost() {
  RunningImu running;
  Icm20948& imu = running.imu;
  imu.data_ready(1000);
  CHECK(imu.next(305, &running.op));  // late
  imu.data_ready(5444);               // before or after the chip gave the burst out: nobody knows
  imu.done(306, running.chip.transfer(running.op, running.data), running.data);
  CHECK(!imu.take(&running.packet) && imu.lost() == 1);
  CHECK(running.read(307) && running.packet.sequence == 1 && running.packet.t_us == 5444);
  imu.count_sent();
  CHECK(imu.lost() == 1);
}

// A finder at work: 1 ms steps, an HC-SR04 that raises ECHO so long after TRIG and holds it for so long (none: 0).
struct Sonar {
  RangeFinder finder;
  uint32_t now_us = 0;
  uint32_t answer_us = 450, echo_us = 2900;
  bool is_held = false;
  uint32_t asked_us = 0;
  bool has_asked = false;
  int triggers = 0, interrupts = 0;
  std::vector<RangePacket> got;

  explicit Sonar(uint8_t period_ms, uint32_t start_us = 0) : now_us(start_us) { finder.configure(ConfigRange{period_ms}); }

  void run(uint32_t ms) {
    bool awaits = false, rose = false, fell = false;
    for (const uint32_t end_us = now_us + 1000 * ms; now_us != end_us; now_us += 50) {
      if (has_asked && echo_us != 0 && now_us - asked_us >= answer_us && !rose) {
        rose = true;
        if (awaits && ++interrupts) awaits = finder.edge(asked_us + answer_us);
      }
      if (rose && !fell && now_us - asked_us >= answer_us + echo_us) {
        fell = true;
        if (awaits && ++interrupts) awaits = finder.edge(asked_us + answer_us + echo_us);
      }
      if (now_us % 1000 != 0) continue;
      if (finder.next(now_us / 1000, now_us, is_held || (rose && !fell))) {
        ++triggers;
        has_asked = awaits = true;
        rose = fell = false;
        asked_us = now_us;
      }
      RangePacket packet;
      if (finder.take(&packet)) got.push_back(packet);
    }
  }
};

static void test_no_sensor_is_asked_before_a_period_is_set() {
  RangeFinder finder;
  for (uint32_t ms = 0; ms < 1000; ++ms) CHECK(!finder.next(ms, 1000 * ms, false) && !finder.edge(1000 * ms));
  RangePacket packet;
  CHECK(!finder.take(&packet));
}

static void test_each_period_gives_one_echo_with_the_time_when_the_sound_turned_round() {
  Sonar sonar(100);
  sonar.run(1000);
  CHECK(sonar.got.size() == 10 && sonar.triggers == 10 && sonar.interrupts == 20);
  for (size_t i = 0; i < sonar.got.size(); ++i) {
    CHECK(sonar.got[i].sequence == i && sonar.got[i].echo == Echo::HEARD && sonar.got[i].echo_us == 2900);
    CHECK(sonar.got[i].t_us == 100000 * i + 450 + 1450);
  }
}

static void test_echoes_are_measured_across_the_wrap_of_both_clocks() {
  RangeFinder late;
  late.configure(ConfigRange{100});
  CHECK(late.next(0xFFFFFFFEu, 0xFFFFFF00u, false));
  CHECK(late.edge(0xFFFFFF80u) && !late.edge(0x00000400u));
  RangePacket packet;
  CHECK(late.take(&packet) && packet.echo_us == 0x480 && packet.t_us == 0xFFFFFF80u + 0x240);
  CHECK(!late.next(20, 0, false) && late.next(98, 0, false));
}

static void test_nothing_in_reach_is_told_and_the_next_is_asked_only_when_the_sensor_has_ended() {
  Sonar sonar(50);
  sonar.echo_us = 38000;
  sonar.run(1000);
  CHECK(sonar.got.size() == 20 && sonar.triggers == 20);
  for (const RangePacket& packet : sonar.got) CHECK(packet.echo == Echo::NONE && packet.echo_us == 0);
  sonar.echo_us = 200000;  // a copy
  sonar.run(2010);
  CHECK(sonar.got.size() >= 28 && sonar.got.size() <= 31);
  CHECK(sonar.got.back().echo == Echo::NONE);
  sonar.echo_us = MAX_ECHO_US + 50;  // known by its fall, before we give up
  sonar.run(500);
  CHECK(sonar.got.back().echo == Echo::NONE);
  sonar.echo_us = MAX_ECHO_US;
  sonar.run(500);
  CHECK(sonar.got.back().echo == Echo::HEARD && sonar.got.back().echo_us == MAX_ECHO_US);
}

static void test_a_sensor_that_does_not_answer_is_told_and_asked_again() {
  Sonar sonar(100);
  sonar.echo_us = 0;  // no ECHO at all
  sonar.run(500);
  CHECK(sonar.got.size() == 5 && sonar.triggers == 5);
  for (const RangePacket& packet : sonar.got) CHECK(packet.echo == Echo::SILENT);
  sonar.is_held = true;  // unplugged: the pull-up
  sonar.run(2000);
  CHECK(sonar.triggers == 5 && sonar.got.size() >= 5 + 5 && sonar.got.back().echo == Echo::SILENT);
  sonar.is_held = false;
  sonar.echo_us = 1000;
  sonar.run(500);
  CHECK(sonar.got.back().echo == Echo::HEARD && sonar.got.back().echo_us == 1000);
}

static void test_an_echo_shorter_than_any_is_no_echo() {
  Sonar sonar(100);
  sonar.echo_us = 50;
  sonar.run(300);
  CHECK(sonar.got.size() == 3 && sonar.got.back().echo == Echo::SILENT);
  sonar.echo_us = MIN_ECHO_US;
  sonar.run(300);
  CHECK(sonar.got.back().echo == Echo::HEARD && sonar.got.back().echo_us == MIN_ECHO_US);
}

static void test_edges_that_nobody_awaits_change_nothing() {
  RangeFinder finder;
  finder.configure(ConfigRange{100});
  CHECK(finder.next(0, 0, false));
  CHECK(finder.edge(500) && !finder.edge(1500));
  for (uint32_t t = 1600; t < 90000; t += 100) CHECK(!finder.edge(t));
  RangePacket packet;
  CHECK(finder.take(&packet) && packet.echo_us == 1000 && !finder.take(&packet));
  for (uint32_t t = 90000; t < 99000; t += 100) CHECK(!finder.edge(t));
  CHECK(!finder.take(&packet));
}

static void test_a_repeated_range_setting_interrupts_no_measurement_and_none_ends_them() {
  RangeFinder finder;
  finder.configure(ConfigRange{100});
  CHECK(finder.next(0, 0, false) && finder.edge(500));
  finder.configure(ConfigRange{100});
  RangePacket packet;
  CHECK(!finder.edge(1500) && finder.take(&packet) && packet.echo_us == 1000);
  finder.configure(ConfigRange{0});
  for (uint32_t ms = 1; ms < 500; ++ms) CHECK(!finder.next(ms, 1000 * ms, false));
}

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  load_golden(argv[1]);
  const std::vector<std::pair<const char*, void (*)()>> tests = {
#define TEST(name) {#name, name}
      TEST(test_crc_of_the_check_string),
      TEST(test_packed_messages_equal_the_golden_bytes),
      TEST(test_frames_equal_the_golden_bytes_and_parse_back),
      TEST(test_golden_commands_parse_to_their_values),
      TEST(test_commands_out_of_range_are_refused),
      TEST(test_damage_costs_one_frame_and_an_overlong_one_is_dropped),
      TEST(test_cobs_keeps_every_length_and_zero_pattern),
      TEST(test_ring_buffer_keeps_order_and_refuses_when_full),
      TEST(test_a_command_lives_from_when_it_was_made_however_late_it_comes),
      TEST(test_what_comes_after_its_end_neither_starts_motors_nor_keeps_them_running),
      TEST(test_motors_are_off_until_a_command_and_stop_when_commands_go_silent),
      TEST(test_time_to_live_has_an_upper_bound),
      TEST(test_stop_is_at_once_and_a_fresh_command_is_needed),
      TEST(test_speed_ramps_and_reverses_through_zero),
      TEST(test_low_battery_holds_the_motors_off_until_it_recovers),
      TEST(test_a_repeated_configuration_keeps_an_empty_battery_empty),
      TEST(test_bridge_inputs_follow_the_driver_s_truth_table),
      TEST(test_every_duty_has_its_counts_in_both_decays),
      TEST(test_imu_set_up_leaves_the_registers_as_meant),
      TEST(test_imu_is_found_at_its_other_address_and_without_magnetometer),
      TEST(test_every_data_ready_gives_one_packet_with_its_own_stamp),
      TEST(test_imu_comes_back_after_it_was_unplugged),
      TEST(test_imu_that_falls_silent_is_set_up_again),
      TEST(test_imu_takes_new_scales_and_rate),
      TEST(test_imu_settings_come_while_any_operation_is_on_the_bus),
      TEST(test_every_sample_is_sent_or_counted_as_lost),
      TEST(test_each_set_up_anew_leaves_a_hole_in_the_numbers),
      TEST(test_a_sample_that_comes_during_a_burst_makes_it_uncertain_and_lost),
      TEST(test_no_sensor_is_asked_before_a_period_is_set),
      TEST(test_each_period_gives_one_echo_with_the_time_when_the_sound_turned_round),
      TEST(test_echoes_are_measured_across_the_wrap_of_both_clocks),
      TEST(test_nothing_in_reach_is_told_and_the_next_is_asked_only_when_the_sensor_has_ended),
      TEST(test_a_sensor_that_does_not_answer_is_told_and_asked_again),
      TEST(test_an_echo_shorter_than_any_is_no_echo),
      TEST(test_edges_that_nobody_awaits_change_nothing),
      TEST(test_a_repeated_range_setting_interrupts_no_measurement_and_none_ends_them),
  };
  for (const auto& test : tests) {
    const int before = failures;
    test.second();
    std::printf("%s %s\n", failures == before ? "ok" : "FAILED", test.first);
  }
  return failures == 0 ? 0 : 1;
}
