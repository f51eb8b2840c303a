/* Model of an ICM-20948 with its AK09916: registers, banks, start-up times, data-ready pulses. Times are microseconds. */
#pragma once
#include <stdint.h>

enum { ICM_BURST_BANKS = 4, ICM_REGISTERS = 128 };

struct icm {
  uint8_t address; /* 7 bits: 0x68 or 0x69 */
  int plugged;
  int mag_present;
  uint8_t reg[ICM_BURST_BANKS][ICM_REGISTERS];
  uint8_t bank, pointer;
  double deaf_until_us;  /* after a reset: registers neither read nor write */
  double gyro_ready_us;  /* first sample after waking up */
  double next_sample_us;
  double clock_ppm;      /* the chip's own oscillator */
  uint64_t samples;
  /* source of the numbers: a pattern that tells the sample's number, or physical values */
  int pattern;
  double accel[3], gyro[3], mag[3]; /* m/s^2, rad/s, uT in the IMU's axes */
  uint8_t mag_reg[64];
  double next_mag_us;
  double slave4_done_us;
  uint8_t slave4_data;
};

void icm_power_on(struct icm *chip, double now_us);
int icm_write(struct icm *chip, double now_us, uint8_t byte, int first); /* 1: acknowledged */
uint8_t icm_read(struct icm *chip, double now_us);
/* Time of the next sample, or a large number while it makes none. */
double icm_next_us(const struct icm *chip);
/* Takes the sample that is due; 1 where the data-ready pin pulses. */
int icm_sample(struct icm *chip);
int icm_selected(const struct icm *chip, double now_us, uint8_t address7);
