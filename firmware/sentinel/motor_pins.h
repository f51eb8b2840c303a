// The motors, shared by the 1 kHz interrupt and the main loop.
#pragma once
#include "motors.h"

extern sentinel::MotorControl motors;  // main loop: only with interrupts off

bool motor_driver_fault();  // DRV8833 pulls FLT low (it floats while the driver sleeps)
