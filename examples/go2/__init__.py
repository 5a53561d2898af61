"""A Unitree Go2 that walks in MuJoCo, so that the forces on its feet are known exactly."""
