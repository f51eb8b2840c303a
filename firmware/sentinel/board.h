// Pins and timers of the Mega. docs/robot.md has the wiring table; both name the same pins.
#pragma once
#include <avr/io.h>
#include <stdint.h>

// Timer 2: 1 kHz tick, motor watchdog. Timer 5: microseconds, and when ECHO changed. Timers 3, 4: motor PWM. Timer 1: servos.
//
// | what                 | Mega pin | port | timer |
// | IMU INT              | 2        | PE4  | INT4  |
// | IMU SDA, SCL         | 20, 21   | PD1, PD0 |   |
// | left IN1, IN2        | 6, 7     | PH3, PH4 | OC4A, OC4B |
// | right IN1, IN2       | 5, 3     | PE3, PE5 | OC3A, OC3C |
// | DRV8833 SLP          | 4        | PG5  |       |
// | DRV8833 FLT          | 8        | PH5  |       |
// | pan, tilt servo      | 11, 12   | PB5, PB6 | OC1A, OC1B |
// | battery divider      | A0       | PF0  |       |
// | HC-SR04 ECHO         | 48       | PL1  | ICP5  |
// | HC-SR04 TRIG         | 49       | PL0  |       |

const uint16_t BATTERY_FULL_SCALE_MV = 10319;  // 2.56 V reference through 100 kOhm over 33 kOhm: 2560 * 133 / 33

void clock_begin();
uint32_t clock_us();          // any context
uint32_t clock_us_in_isr();   // interrupts off
uint32_t clock_ms();
extern volatile uint8_t clock_unfed_ms;  // since the loop last fed the watchdog, 255 at most; survives a reset

void range_begin();
void range_listen();          // for the next echo; interrupts off
void range_sound();           // takes 13 us; interrupts may come meanwhile
bool range_echo_is_high();

void motors_begin();
void servos_begin();
void servos_set(uint16_t pan_us, uint16_t tilt_us);  // 0 lets a servo go

void adc_begin();
bool adc_poll(uint16_t* battery_mv);  // true when a new value is there; starts the next conversion by itself
