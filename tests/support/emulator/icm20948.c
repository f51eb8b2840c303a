/* Registers: TDK DS-000189 v1.3, chapters 7-11; AK09916: AKM 015007392-E-02. */
#include "icm20948.h"

#include <math.h>
#include <string.h>

#define NEVER 1e18

enum {
  WHO_AM_I = 0x00, USER_CTRL = 0x03, PWR_MGMT_1 = 0x06, INT_PIN_CFG = 0x0F, INT_ENABLE_1 = 0x11, MST_STATUS = 0x17,
  ACCEL_OUT = 0x2D, EXT_DATA = 0x3B, BANK_SEL = 0x7F,
  B2_GYRO_DIV = 0x00, B2_GYRO_CONFIG = 0x01, B2_ACCEL_CONFIG = 0x14,
  B3_S0_ADDR = 0x03, B3_S0_REG = 0x04, B3_S0_CTRL = 0x05, B3_S4_ADDR = 0x13, B3_S4_REG = 0x14, B3_S4_CTRL = 0x15, B3_S4_DO = 0x16,
  AK_ADDRESS = 0x0C, AK_ST1 = 0x10, AK_ST2 = 0x18, AK_CNTL2 = 0x31, AK_CNTL3 = 0x32,
};

static void reset_mag(struct icm *chip) {
  memset(chip->mag_reg, 0, sizeof chip->mag_reg);
  chip->mag_reg[0] = 0x48;
  chip->mag_reg[1] = 0x09;
  chip->next_mag_us = NEVER;
}

static void reset(struct icm *chip, double now_us, double deaf_us) {
  memset(chip->reg, 0, sizeof chip->reg);
  chip->reg[0][WHO_AM_I] = 0xEA;
  chip->reg[0][PWR_MGMT_1] = 0x41; /* asleep */
  chip->reg[0][0x05] = 0x40;
  chip->reg[2][B2_GYRO_CONFIG] = 0x01;
  chip->reg[2][B2_ACCEL_CONFIG] = 0x01;
  chip->bank = 0;
  chip->deaf_until_us = now_us + deaf_us;
  chip->next_sample_us = NEVER;
  chip->slave4_done_us = NEVER;
}

void icm_power_on(struct icm *chip, double now_us) {
  reset(chip, now_us, 100000);
  reset_mag(chip); /* a soft reset of the big chip does not reset the small one */
}

int icm_selected(const struct icm *chip, double now_us, uint8_t address7) {
  return chip->plugged && address7 == chip->address && now_us >= chip->deaf_until_us;
}

static double period_us(const struct icm *chip) {
  return 1e6 * (1 + chip->reg[2][B2_GYRO_DIV]) / 1125.0 / (1 + chip->clock_ppm * 1e-6);
}

static int mag_write(struct icm *chip, double now_us, uint8_t reg, uint8_t value) {
  if (!chip->mag_present) return 0;
  if (reg == AK_CNTL3 && (value & 1)) reset_mag(chip);
  if (reg == AK_CNTL2) {
    chip->mag_reg[AK_CNTL2] = value;
    chip->next_mag_us = value == 0x08 ? now_us + 10000 : NEVER;
  }
  return 1;
}

static void mag_measure(struct icm *chip, double now_us) {
  while (chip->next_mag_us <= now_us) {
    chip->next_mag_us += 10000;
    /* y and z point against the IMU's */
    const double axes[3] = {chip->mag[0], -chip->mag[1], -chip->mag[2]};
    for (int i = 0; i < 3; ++i) {
      const int16_t counts = (int16_t)lrint(axes[i] / 0.15);
      chip->mag_reg[0x11 + 2 * i] = (uint8_t)counts;
      chip->mag_reg[0x12 + 2 * i] = (uint8_t)(counts >> 8);
    }
    if (chip->mag_reg[AK_ST1] & 1) chip->mag_reg[AK_ST1] |= 2; /* overrun */
    chip->mag_reg[AK_ST1] |= 1;
    chip->mag_reg[AK_ST2] = 0x10;
  }
}

static uint8_t mag_read(struct icm *chip, uint8_t reg) {
  const uint8_t value = chip->mag_reg[reg & 63];
  if (reg == AK_ST2) chip->mag_reg[AK_ST1] = 0;
  return value;
}

static void aux_write(struct icm *chip, double now_us, uint8_t reg, uint8_t value) {
  if (chip->bank == 3 && reg == B3_S4_CTRL && (value & 0x80) && (chip->reg[0][USER_CTRL] & 0x20)) {
    chip->slave4_done_us = now_us + 1000;
    const uint8_t address = chip->reg[3][B3_S4_ADDR];
    int ok = (address & 0x7F) == AK_ADDRESS && chip->mag_present;
    if (ok && !(address & 0x80)) ok = mag_write(chip, now_us, chip->reg[3][B3_S4_REG], chip->reg[3][B3_S4_DO]);
    chip->slave4_data = ok ? 0x40 : 0x50;
  }
}

int icm_write(struct icm *chip, double now_us, uint8_t byte, int first) {
  if (now_us < chip->deaf_until_us) return 0;
  if (first) {
    chip->pointer = byte & 0x7F;
    return 1;
  }
  const uint8_t reg = chip->pointer;
  chip->pointer = (chip->pointer + 1) & 0x7F;
  if (reg == BANK_SEL) {
    chip->bank = (byte >> 4) & 3;
    return 1;
  }
  if (chip->bank == 0 && reg == WHO_AM_I) return 1;
  if (chip->bank == 0 && reg == PWR_MGMT_1) {
    if (byte & 0x80) {
      reset(chip, now_us, 11000);
      return 1;
    }
    if (!(byte & 0x40) && (chip->reg[0][PWR_MGMT_1] & 0x40)) chip->next_sample_us = now_us + 35000;
    if (byte & 0x40) chip->next_sample_us = NEVER;
  }
  chip->reg[chip->bank][reg] = byte;
  aux_write(chip, now_us, reg, byte);
  return 1;
}

uint8_t icm_read(struct icm *chip, double now_us) {
  const uint8_t reg = chip->pointer;
  chip->pointer = (chip->pointer + 1) & 0x7F;
  if (reg == BANK_SEL) return (uint8_t)(chip->bank << 4);
  if (chip->bank == 0 && reg == MST_STATUS) {
    if (now_us < chip->slave4_done_us) return 0;
    chip->slave4_done_us = NEVER;
    return chip->slave4_data;
  }
  return chip->reg[chip->bank][reg];
}

double icm_next_us(const struct icm *chip) { return chip->plugged ? chip->next_sample_us : NEVER; }

static int16_t saturate(double counts) {
  return (int16_t)lrint(counts > 32767 ? 32767 : counts < -32768 ? -32768 : counts);
}

static void put16(uint8_t *at, int16_t value) {
  at[0] = (uint8_t)((uint16_t)value >> 8);
  at[1] = (uint8_t)value;
}

int icm_sample(struct icm *chip) {
  const double now_us = chip->next_sample_us;
  chip->next_sample_us += period_us(chip);
  uint8_t *out = chip->reg[0];
  const double accel_unit = (2 << ((chip->reg[2][B2_ACCEL_CONFIG] >> 1) & 3)) * 9.80665 / 32768;
  const double gyro_unit = (250 << ((chip->reg[2][B2_GYRO_CONFIG] >> 1) & 3)) * (M_PI / 180) / 32768;
  for (int i = 0; i < 3; ++i) {
    /* the pattern: six different linear functions of the sample's number */
    const uint16_t n = (uint16_t)chip->samples;
    put16(out + ACCEL_OUT + 2 * i, chip->pattern ? (int16_t)(uint16_t)(n * (i + 1)) : saturate(chip->accel[i] / accel_unit));
    put16(out + ACCEL_OUT + 6 + 2 * i, chip->pattern ? (int16_t)(uint16_t)(n * (i + 5)) : saturate(chip->gyro[i] / gyro_unit));
  }
  put16(out + ACCEL_OUT + 12, saturate((30.0 - 21.0) * 333.87));
  mag_measure(chip, now_us);
  const uint8_t control = chip->reg[3][B3_S0_CTRL];
  if ((out[USER_CTRL] & 0x20) && (control & 0x80) && chip->reg[3][B3_S0_ADDR] == (0x80 | AK_ADDRESS) && chip->mag_present) {
    for (int i = 0; i < (control & 15); ++i) out[EXT_DATA + i] = mag_read(chip, (uint8_t)(chip->reg[3][B3_S0_REG] + i));
  }
  ++chip->samples;
  return out[INT_ENABLE_1] & 1;
}
