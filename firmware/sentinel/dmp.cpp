// Not compiled by default: the vendor's image has no clear licence and is not part of this firmware. docs/firmware.md.
#include "board.h"
#ifdef SENTINEL_DMP
#include "dmp.h"

#include <ICM_20948.h>  // SparkFun 9DoF IMU breakout library, with ICM_20948_USE_DMP defined in its ICM_20948_C.h
#include <Wire.h>
#include <math.h>

static ICM_20948_I2C chip;
static const double ONE_Q30 = 1073741824.0;

bool dmp_begin() {
  Wire.begin();
  Wire.setClock(400000);
  // A bus that a device holds must not stop the main loop for longer than the AVR's watchdog waits (120 ms).
  Wire.setWireTimeout(5000, true);
  for (uint8_t low_address = 0; low_address < 2; ++low_address) {
    if (chip.begin(Wire, low_address == 0) != ICM_20948_Stat_Ok) continue;
    bool ok = chip.initializeDMP() == ICM_20948_Stat_Ok;
    ok &= chip.enableDMPSensor(INV_ICM20948_SENSOR_GAME_ROTATION_VECTOR) == ICM_20948_Stat_Ok;
    ok &= chip.setDMPODRrate(DMP_ODR_Reg_Quat6, 0) == ICM_20948_Stat_Ok;  // 0: the DMP's full rate, 55 Hz by default
    ok &= chip.enableFIFO() == ICM_20948_Stat_Ok && chip.enableDMP() == ICM_20948_Stat_Ok;
    ok &= chip.resetDMP() == ICM_20948_Stat_Ok && chip.resetFIFO() == ICM_20948_Stat_Ok;
    return ok;
  }
  return false;
}

bool dmp_read(int32_t q_wxyz[4]) {
  icm_20948_DMP_data_t data;
  chip.readDMPdataFromFIFO(&data);
  if (chip.status != ICM_20948_Stat_Ok && chip.status != ICM_20948_Stat_FIFOMoreDataAvail) return false;
  if ((data.header & DMP_header_bitmap_Quat6) == 0) return false;
  // Three of four are sent; the fourth makes the length one.
  double sum = 0;
  const int32_t xyz[3] = {data.Quat6.Data.Q1, data.Quat6.Data.Q2, data.Quat6.Data.Q3};
  for (uint8_t i = 0; i < 3; ++i) {
    q_wxyz[i + 1] = xyz[i];
    sum += (xyz[i] / ONE_Q30) * (xyz[i] / ONE_Q30);
  }
  q_wxyz[0] = static_cast<int32_t>(sum < 1 ? sqrt(1 - sum) * ONE_Q30 : 0);
  return true;
}
#endif
