"""Make a Unitree Go2 walk on sand in MuJoCo, and write its log and what is true of the sand.

    python examples/sand_walk.py --out sand --gait walk --seed 1
    terraphi footfalls sand/walk.csv --density 1550±80 --out soil.nc

The feet feel a force law on sand whose friction angle is a random field and whose surface
undulates; the log has the errors of sensors (noise, encoders, lost messages), of each motor's
torque gain and of the attitude. It needs the extra ``robot``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from go2 import logs
from go2.control import Aim
from go2.gait import Gait
from go2.model import Physics
from go2.sand import Field, Sand
from go2.sensors import Sensors, realistic_log
from go2.walk import Recording, Walk

from terraphi.laws.foot import LAWS
from terraphi.robot.forces import SensorErrors
from terraphi.robot.joint_log import FEET, JointLog

GAITS = {
    "walk": (Gait("walk", 1.2, ramp=0.15), Aim(speed=0.12, height=0.3)),
    "trot": (Gait("trot", 0.5, ramp=0.08), Aim(speed=0.25, height=0.3)),
    "fast": (Gait("trot", 0.5, ramp=0.08), Aim(speed=0.5, height=0.3)),
    "slow": (Gait("walk", 1.6, ramp=0.2), Aim(speed=0.08, height=0.3)),
    "limp": (Gait("walk", 1.2, ramp=0.15, spared=0.6), Aim(speed=0.12, height=0.3)),
}
"""A walk, two trots, a slow walk, and one that spares a leg."""
TILT = 0.005
"""Standard deviation of a constant error of the attitude [rad]."""


def sand_walk(
    gait: str,
    *,
    seed: int,
    law: str = "foot",
    duration: float = 20.0,
    mean: float = 42.0,
    spread: float = 1.5,
    length: float = 1.0,
) -> Walk:
    """A walk on sand whose φ and surface are drawn by a seed; a floor for law ``floor``.

    ``mean`` and ``spread`` are of φ [deg]; it changes over the ``length`` [m].
    """
    rng = np.random.default_rng(1000 + seed)
    phi = Field(mean + rng.normal(0.0, 1.5), spread, length, seed)
    sand = None
    if law != "floor":
        sand = Sand(phi=phi, surface=Field(0.0, 0.005, 0.4, seed + 500), law=law)
    how, aim = GAITS[gait]
    physics = Physics(coulomb=0.2, viscous=0.05)
    return Walk(duration=duration, gait=how, aim=aim, physics=physics, sand=sand, seed=seed)


def sand_log(recording: Recording, *, seed: int, gain_sd: float = SensorErrors.gain) -> JointLog:
    """What the robot logs of a recording, with errors drawn by a seed."""
    rng = np.random.default_rng(seed)
    # A current is measured over the time since the last message, not at an instant.
    torque = recording.torque.copy()
    torque[1:] = 0.5 * (torque[1:] + torque[:-1])
    log = realistic_log(replace(recording, torque=torque), Sensors(), seed=seed)
    assert log.quaternion is not None
    w, x, y, z = log.quaternion.T
    a, b = 0.5 * rng.normal(0.0, TILT, 2)
    tilted = log.quaternion + np.stack(
        [-a * x - b * y, a * w + b * z, b * w - a * z, a * y - b * x], axis=1
    )
    return replace(
        log,
        torque=log.torque * (1.0 + rng.normal(0.0, gain_sd, (4, 3))),
        quaternion=tilted / np.linalg.norm(tilted, axis=1, keepdims=True),
    )


@click.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("sand"), show_default=True)
@click.option("--gait", type=click.Choice(sorted(GAITS)), default="walk", show_default=True)
@click.option("--law", type=click.Choice([*LAWS, "floor"]), default="foot", show_default=True)
@click.option("--mean", type=float, default=42.0, show_default=True, help="Mean φ [deg].")
@click.option("--duration", type=float, default=20.0, show_default=True, help="[s].")
@click.option("--gain-sd", type=float, default=SensorErrors.gain, show_default=True, help="[-].")
@click.option("--seed", type=int, default=0, show_default=True)
def main(
    out: Path, gait: str, law: str, mean: float, duration: float, gain_sd: float, seed: int
) -> None:
    """Simulate a Go2 on sand; write walk.csv, its log, and truth.csv, φ where its feet stood."""
    out.mkdir(parents=True, exist_ok=True)
    walk = sand_walk(gait, seed=seed, law=law, duration=duration, mean=mean)
    recording = walk.run()
    logs.write_csv(out / "walk.csv", sand_log(recording, seed=seed, gain_sd=gain_sd))
    loaded = recording.force[..., 2] > 10.0
    touched = loaded[1:] & ~loaded[:-1]
    start = recording.position[0, :2]
    with (out / "truth.csv").open("w") as stream:
        stream.write("t_s,foot,x_m,y_m,phi_deg\n")
        for i, foot in np.argwhere(touched):
            place = recording.foot_position[i, foot]
            phi = float("nan") if walk.sand is None else float(walk.sand.phi(place))
            x, y = place[:2] - start
            stream.write(f"{recording.time[i]:.3f},{FEET[foot]},{x:.4f},{y:.4f},{phi:.4f}\n")
    gone = float(np.linalg.norm(recording.position[-1, :2] - start))
    click.echo(f"{recording.time[-1]:.1f} s, {gone:.2f} m, {int(touched.sum())} touch-downs")
    click.echo(f"Written: {out}/walk.csv, {out}/truth.csv")


if __name__ == "__main__":
    main()
