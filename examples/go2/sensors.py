"""What the robot's own sensors make of a walk: logs at 500 Hz, exact or with all their errors."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from go2.walk import RATE, Recording, Walk
from terraphi.experiment.files import write_netcdf
from terraphi.robot.joint_log import FEET, JointLog

FloatArray = NDArray[np.float64]

LOG_RATE = 500.0
"""Messages per second of a Go2 [Hz]."""
GEAR = 6.33
"""Reduction of hip and thigh [-]; the encoders sit on the rotors."""


@dataclass(frozen=True)
class Sensors:
    """Errors of the sensors.

    Attributes
    ----------
    encoder_counts
        Counts in a turn of a rotor [-].
    velocity_noise
        Standard deviation of joint velocities [rad/s].
    torque_step
        Smallest difference between torques [N m].
    torque_noise
        Standard deviation of torques, which are made of motor currents [N m].
    attitude_noise
        Standard deviation of a slowly drifting error of attitude [rad].
    gyro_noise, acceleration_noise
        Standard deviations [rad/s], [m/s²].
    jitter
        Standard deviation of the intervals at which samples are taken [s].
    stamp_error
        Standard deviation of the difference between a message's stamp and its sample [s].
    dropped
        Part of the messages that are lost one by one [-].
    burst_s, burst_length
        Mean time between longer losses [s], and messages in each.
    """

    encoder_counts: int = 32768
    velocity_noise: float = 0.01
    torque_step: float = GEAR / 256.0
    torque_noise: float = 0.1
    attitude_noise: float = 0.003
    gyro_noise: float = 0.005
    acceleration_noise: float = 0.1
    jitter: float = 1e-4
    stamp_error: float = 2e-5
    dropped: float = 0.005
    burst_s: float = 4.0
    burst_length: int = 6


def exact_log(recording: Recording) -> JointLog:
    """Every second sample of a recording, as it is.

    Parameters
    ----------
    recording
        What happened.

    Returns
    -------
    JointLog
    """
    every = round(RATE / LOG_RATE)
    return JointLog(
        time=recording.time[::every].copy(),
        angle=recording.angle[::every].copy(),
        velocity=recording.velocity[::every].copy(),
        torque=recording.torque[::every].copy(),
        quaternion=recording.quaternion[::every].copy(),
        angular_velocity=recording.angular_velocity[::every].copy(),
        acceleration=recording.acceleration[::every].copy(),
        foot_counts=_counts(recording.force[::every]),
        report={"source": "simulation"},
    )


def realistic_log(recording: Recording, sensors: Sensors, *, seed: int = 0) -> JointLog:
    """What a robot would have logged: noisy, quantised, late, and not all of it.

    Parameters
    ----------
    recording
        What happened.
    sensors
        How wrong it is seen.
    seed
        Of all errors.

    Returns
    -------
    JointLog
    """
    rng = np.random.default_rng(seed)
    nominal = np.arange(0.0, recording.time[-1], 1.0 / LOG_RATE)
    jitter = rng.normal(0.0, sensors.jitter, len(nominal)).clip(-4e-4, 4e-4)
    time = np.clip(nominal + jitter, 0.0, recording.time[-1])
    time = time[_kept(len(time), sensors, rng)]

    def sampled(values: FloatArray, noise: float = 0.0) -> FloatArray:
        seen = _at(time, recording.time, values)
        return seen + rng.normal(0.0, noise, seen.shape) if noise else seen

    count = 2.0 * np.pi / sensors.encoder_counts / GEAR
    torque = sampled(recording.torque, sensors.torque_noise)
    stamps = time + rng.normal(0.0, sensors.stamp_error, len(time)).clip(-4e-5, 4e-5)
    return JointLog(
        time=stamps,
        angle=count * np.round(sampled(recording.angle) / count),
        velocity=sampled(recording.velocity, sensors.velocity_noise),
        torque=sensors.torque_step * np.round(torque / sensors.torque_step),
        quaternion=_drifted(sampled(recording.quaternion), time, sensors.attitude_noise, rng),
        angular_velocity=sampled(recording.angular_velocity, sensors.gyro_noise),
        acceleration=sampled(recording.acceleration, sensors.acceleration_noise),
        foot_counts=_counts(sampled(recording.force, 2.0)),
        report={"source": "simulation", "sensors": asdict(sensors), "seed": seed},
    )


def write_truth(recording: Recording, walk: Walk, path: Path) -> None:
    """Write the exact forces and the motion as NetCDF.

    Parameters
    ----------
    recording
        What happened.
    walk
        The run that it was.
    path
        The file.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    import xarray as xr

    def of_feet(values: FloatArray, units: str, name: str) -> tuple[object, ...]:
        return ("time", "foot", "axis"), values, {"units": units, "long_name": name}

    dataset = xr.Dataset(
        {
            "force": of_feet(recording.force, "N", "force of the ground on the foot"),
            "foot_position": of_feet(recording.foot_position, "m", "centre of the foot"),
            "foot_velocity": of_feet(recording.foot_velocity, "m/s", "velocity of the foot"),
            "position": (("time", "axis"), recording.position, {"units": "m"}),
            "velocity": (("time", "axis"), recording.body_velocity, {"units": "m/s"}),
            "quaternion": (("time", "part"), recording.quaternion),
        },
        coords={
            "time": ("time", recording.time, {"units": "s"}),
            "foot": list(FEET),
            "axis": list("xyz"),
            "part": list("wxyz"),
        },
        attrs={"frame": "world", "walk": json.dumps(asdict(walk))},
    )
    write_netcdf(dataset, path)


def _at(when: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    """Values between samples at a constant rate, linearly; first axis is time."""
    place = np.clip((when - time[0]) * RATE, 0.0, len(time) - 1.001)
    left = place.astype(np.int64)
    part = (place - left).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1.0 - part) * values[left] + part * values[left + 1])


def _kept(count: int, sensors: Sensors, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which messages arrive."""
    kept = rng.random(count) >= sensors.dropped
    bursts = rng.random(count) < 1.0 / (sensors.burst_s * LOG_RATE)
    for start in np.flatnonzero(bursts):
        kept[start : start + sensors.burst_length] = False
    return kept


def _drifted(
    quaternion: FloatArray, time: FloatArray, noise: float, rng: np.random.Generator
) -> FloatArray:
    """Attitudes with a slow error about each axis of the world, unit again."""
    error = np.zeros((len(time), 4))
    for axis in range(1, 4):
        phase, period = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(5.0, 15.0)
        error[:, axis] = noise / np.sqrt(2.0) * np.sin(2.0 * np.pi * time / period + phase)
    w, x, y, z = quaternion.T
    a, b, c = error[:, 1:].T
    turned = quaternion + np.stack(
        [
            -a * x - b * y - c * z,
            a * w + b * z - c * y,
            b * w + c * x - a * z,
            c * w + a * y - b * x,
        ],
        axis=1,
    )
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _counts(force: FloatArray) -> FloatArray:
    """Readings of foot sensors: whole numbers that grow with the load, each foot in its own way."""
    load = np.linalg.norm(force, axis=-1)
    return np.round(np.array([18.0, 22.0, 15.0, 25.0]) + load * np.array([0.9, 1.3, 1.1, 0.8]))
