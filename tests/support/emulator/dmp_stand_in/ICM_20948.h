// Declarations of SparkFun's ICM-20948 library (v1.2 and 1.3) that firmware/sentinel/dmp.cpp uses, so that a test compiles it.
// The library itself brings the vendor's image and is not ours to ship.
#pragma once
#include <Wire.h>
#include <stdint.h>

enum ICM_20948_Status_e { ICM_20948_Stat_Ok = 0, ICM_20948_Stat_FIFONoDataAvail, ICM_20948_Stat_FIFOMoreDataAvail };
enum inv_icm20948_sensor { INV_ICM20948_SENSOR_GAME_ROTATION_VECTOR = 15 };
enum DMP_ODR_Registers { DMP_ODR_Reg_Quat6 = 172 };
const uint16_t DMP_header_bitmap_Quat6 = 0x0800;

struct icm_20948_DMP_data_t {
  uint16_t header;
  struct {
    struct {
      int32_t Q1, Q2, Q3;
    } Data;
  } Quat6;
};

class ICM_20948_I2C {
 public:
  ICM_20948_Status_e status;
  ICM_20948_Status_e begin(TwoWire& wire, bool ad0val);
  ICM_20948_Status_e initializeDMP();
  ICM_20948_Status_e enableDMPSensor(inv_icm20948_sensor sensor, bool enable = true);
  ICM_20948_Status_e setDMPODRrate(DMP_ODR_Registers reg, int interval);
  ICM_20948_Status_e enableFIFO(bool enable = true);
  ICM_20948_Status_e enableDMP(bool enable = true);
  ICM_20948_Status_e resetDMP();
  ICM_20948_Status_e resetFIFO();
  ICM_20948_Status_e readDMPdataFromFIFO(icm_20948_DMP_data_t* data);
};
