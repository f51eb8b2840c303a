// Byte queue between an interrupt and the main loop: one writer, one reader, no locks.
#pragma once
#include <stdint.h>

namespace sentinel {

// SIZE is a power of two up to 256; holds SIZE - 1 bytes. Indices are single bytes, which an AVR reads and writes at once.
template <uint16_t SIZE>
class RingBuffer {
  static_assert(SIZE >= 2 && SIZE <= 256 && (SIZE & (SIZE - 1)) == 0, "SIZE is a power of two up to 256");

 public:
  bool push(uint8_t byte) {
    const uint8_t next = static_cast<uint8_t>((head_ + 1) & (SIZE - 1));
    if (next == tail_) return false;
    bytes_[head_] = byte;
    head_ = next;
    return true;
  }
  bool pop(uint8_t* byte) {
    if (head_ == tail_) return false;
    *byte = bytes_[tail_];
    tail_ = static_cast<uint8_t>((tail_ + 1) & (SIZE - 1));
    return true;
  }
  bool empty() const { return head_ == tail_; }
  uint8_t used() const { return static_cast<uint8_t>((head_ - tail_) & (SIZE - 1)); }
  uint8_t room() const { return static_cast<uint8_t>(SIZE - 1 - used()); }

 private:
  volatile uint8_t bytes_[SIZE];
  volatile uint8_t head_ = 0;
  volatile uint8_t tail_ = 0;
};

}  // namespace sentinel
