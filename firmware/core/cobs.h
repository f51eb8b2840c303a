// Consistent Overhead Byte Stuffing (Cheshire and Baker, IEEE/ACM ToN 7(2), 1999): no zero inside, so 0x00 ends a frame.
// Only for frames below 254 bytes, where a code byte never stands for "no zero after me".
#pragma once
#include <stdint.h>

namespace sentinel {

// Encodes `length` < 254 bytes; writes length + 1 bytes without the delimiter and returns that count.
inline uint8_t cobs_encode(const uint8_t* in, uint8_t length, uint8_t* out) {
  uint8_t code_at = 0;
  uint8_t to = 1;
  for (uint8_t i = 0; i < length; ++i) {
    if (in[i] == 0) {
      out[code_at] = static_cast<uint8_t>(to - code_at);
      code_at = to++;
    } else {
      out[to++] = in[i];
    }
  }
  out[code_at] = static_cast<uint8_t>(to - code_at);
  return to;
}

// Decodes `length` bytes (no delimiter) in place. Returns the decoded length, or -1 where a code points beyond the end.
inline int16_t cobs_decode(uint8_t* data, uint8_t length) {
  uint8_t from = 0;
  uint8_t to = 0;
  while (from < length) {
    const uint8_t code = data[from];
    if (code == 0 || code > length - from) return -1;
    for (uint8_t i = 1; i < code; ++i) data[to++] = data[from + i];
    from = static_cast<uint8_t>(from + code);
    if (from < length) data[to++] = 0;
  }
  return to;
}

}  // namespace sentinel
