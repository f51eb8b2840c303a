// Throws damaged frames at the firmware's parser and commands, under sanitizers. Usage: fuzz_core INPUTS SEED.
// Exit code 1 when a motor would have moved: no input holds a valid drive command.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "../core/imu.h"
#include "../core/motors.h"
#include "../core/protocol.h"
#include "../core/range.h"

using namespace sentinel;

typedef std::vector<uint8_t> Bytes;

static uint64_t state;
static uint32_t next_random() {
  state ^= state << 13;
  state ^= state >> 7;
  state ^= state << 17;
  return static_cast<uint32_t>(state >> 32);
}
static uint32_t below(uint32_t n) { return next_random() % n; }

// A well-formed frame of any type, often with a body that is nearly right; a drive's inverted copy is always wrong.
static Bytes frame() {
  static const uint8_t types[] = {0x01, 0x02, 0x03, 0x10, 0x10, 0x10, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x17, 0x7F};
  static const uint8_t lengths[] = {0, 0, 0, 20, 20, 19, 0, 4, 0, 5, 5, 4, 1, 60};
  const uint32_t kind = below(sizeof types);
  uint8_t payload[MAX_PAYLOAD];
  payload[0] = types[kind];
  uint8_t length = static_cast<uint8_t>(1 + (below(8) == 0 ? below(MAX_PAYLOAD - 1) : lengths[kind]));
  for (uint8_t i = 1; i < length; ++i) payload[i] = static_cast<uint8_t>(below(4) == 0 ? below(256) : below(8));
  if (payload[0] == 0x10 && length == 21) {
    for (uint8_t i = 1; i < 11; ++i) payload[i + 10] = static_cast<uint8_t>(~payload[i]);
    payload[1 + below(20)] ^= static_cast<uint8_t>(1 << below(8));
  }
  uint8_t out[MAX_FRAME];
  const uint8_t n = encode_frame(payload, length, out);
  return Bytes(out, out + n);
}

static void damage(Bytes& bytes) {
  for (uint32_t times = below(4); times > 0 && !bytes.empty(); --times) {
    const size_t at = below(static_cast<uint32_t>(bytes.size()));
    switch (below(4)) {
      case 0: bytes[at] ^= static_cast<uint8_t>(1 << below(8)); break;
      case 1: bytes[at] = static_cast<uint8_t>(below(256)); break;
      case 2: bytes.erase(bytes.begin() + static_cast<long>(at)); break;
      default: bytes.insert(bytes.begin() + static_cast<long>(at), static_cast<uint8_t>(below(256))); break;
    }
  }
}

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const long inputs = std::atol(argv[1]);
  state = 0x9E3779B97F4A7C15ull ^ static_cast<uint64_t>(std::atol(argv[2])) * 0xD1342543DE82EF95ull;
  FrameParser parser;
  MotorControl motors;
  Icm20948 imu;
  RangeFinder finder;
  uint32_t asked_us = 0;
  long payloads = 0, refused = 0;
  bool on_the_bus = false;
  BusOp op;
  for (long i = 0; i < inputs; ++i) {
    Bytes input = frame();
    if (below(10) == 0) {
      input.assign(below(200), 0);
      for (uint8_t& byte : input) byte = static_cast<uint8_t>(below(256));
    }
    damage(input);
    for (uint8_t byte : input) {
      if (!parser.feed(byte)) continue;
      ++payloads;
      const uint8_t* body = parser.payload() + 1;
      const uint8_t n = static_cast<uint8_t>(parser.length() - 1);
      Drive drive;
      ConfigImu config_imu;
      ConfigMotors config_motors;
      Servo servo;
      ConfigRange config_range;
      switch (static_cast<Type>(parser.payload()[0])) {
        case Type::DRIVE:
          if (parse(body, n, &drive) == Result::DONE) {
            motors.command(drive, drive.until_ms - 1);  // in time: whatever got through moves
          } else {
            ++refused;
          }
          break;
        case Type::CONFIG_IMU:
          if (parse(body, n, &config_imu) == Result::DONE) imu.configure(config_imu);
          break;
        case Type::CONFIG_MOTORS:
          if (parse(body, n, &config_motors) == Result::DONE) motors.configure(config_motors);
          break;
        case Type::SERVO:
          parse(body, n, &servo);
          break;
        case Type::CONFIG_RANGE:
          if (parse(body, n, &config_range) == Result::DONE) finder.configure(config_range);
          break;
        case Type::STOP:
          motors.stop();
          break;
        default:
          break;
      }
    }
    motors.tick();
    // The chip's side: what the bus brings is as random as what the line brings.
    uint8_t data[IMU_BURST];
    for (uint8_t& byte : data) byte = static_cast<uint8_t>(below(256));
    data[0] = below(2) ? 0xEA : data[0];
    const uint32_t now_ms = static_cast<uint32_t>(i);
    if (below(8) == 0) imu.data_ready(next_random());
    // An operation may last until commands have come in between.
    if (!on_the_bus) on_the_bus = imu.next(now_ms, &op);
    if (on_the_bus && below(2)) {
      imu.done(now_ms, below(16) != 0, data);
      on_the_bus = false;
    }
    ImuPacket packet;
    imu.take(&packet);
    // So are the edges of the range sensor's wire. A measurement awaits two, and ends in time.
    const uint32_t now_us = 1000 * now_ms;
    if (finder.next(now_ms, now_us, below(4) == 0)) asked_us = now_us;
    for (uint32_t edges = below(6), awaited = 0; edges > 0; --edges) {
      awaited += finder.edge(now_us + below(1000));
      if (awaited > 1) {
        std::printf("more than two edges awaited after input %ld\n", i);
        return 1;
      }
    }
    RangePacket range;
    if (finder.take(&range) && range.echo == Echo::HEARD && (range.echo_us > MAX_ECHO_US || range.t_us - asked_us > 100000)) {
      std::printf("no such echo: %u us after input %ld\n", static_cast<unsigned>(range.echo_us), i);
      return 1;
    }
    if (motors.left() != 0 || motors.right() != 0 || motors.bridge() == Bridge::RUN) {
      std::printf("motion after input %ld\n", i);
      return 1;
    }
  }
  std::printf("%ld inputs, %ld payloads passed the CRC, %ld damaged drive commands refused, no motion\n", inputs, payloads, refused);
  return 0;
}
