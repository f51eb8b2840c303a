// How much stack was never used: RAM is painted at reset and looked at a little at a time.
#pragma once
#include <stdint.h>

uint16_t stack_free();  // bytes; scans on by a few dozen bytes per call
