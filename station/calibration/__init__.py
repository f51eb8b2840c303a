"""How a robot's own sensors are calibrated: targets, camera, inertial unit, how they sit on each other, wheels."""

CALIBRATE_CAMERA = "run `station calibrate camera RECORDING --target target.yaml --out camera.yaml`"
