// I2C master at 400 kHz by interrupts: one operation at a time, never waits, and frees a bus that a device holds.
#pragma once
#include <stdint.h>

#include "imu.h"

void bus_begin();
bool bus_idle();
void bus_start(const sentinel::BusOp& op, uint32_t now_us);
// True once when the operation has ended or took too long; `ok` tells which, bus_data() has the bytes read.
bool bus_finished(uint32_t now_us, bool* ok);
bool bus_has_result();
const uint8_t* bus_data();
uint16_t bus_recoveries();
