// UART 0 (USB) at 500 kBd by interrupts. Nothing here waits: what does not fit is dropped and counted.
#pragma once
#include <stdint.h>

void uart_begin();
bool uart_read(uint8_t* byte);
bool uart_send(const uint8_t* data, uint8_t length, uint8_t spare);  // all or nothing, and `spare` bytes stay free
bool uart_has_input();
uint16_t uart_overruns();
