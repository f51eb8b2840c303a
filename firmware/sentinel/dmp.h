// The chip's own motion processor through SparkFun's library, which brings the vendor's image: only with -DSENTINEL_DMP.
#pragma once
#include <stdint.h>

bool dmp_begin();  // false: no chip, or it does not take the image
bool dmp_read(int32_t q_wxyz[4]);  // Q30; true when there was a new one
