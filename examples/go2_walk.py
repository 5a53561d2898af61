"""Make a Unitree Go2 walk in MuJoCo, and write its logs and the true forces on its feet.

    python examples/go2_walk.py --out walk --duration 10

writes ``walk/truth.nc`` and, twice in each format that terraphi reads, what the robot would have
logged: ``exact.*`` without errors, ``realistic.*`` with those of encoders, currents and messages.
It needs the extra ``robot``, and the package ``mcap`` or ``pyarrow`` for these formats.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from go2 import logs
from go2.control import Aim
from go2.gait import PHASES, Gait
from go2.model import Physics
from go2.sensors import Sensors, exact_log, realistic_log, write_truth
from go2.walk import Recording, Walk

from terraphi.robot.joint_log import FEET, JointLog

FORMATS = ("csv", "parquet", "mcap", "rosbag2")


@click.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("go2-walk"), show_default=True)
@click.option("--gait", type=click.Choice(sorted(PHASES)), default="trot", show_default=True)
@click.option("--period", type=float, default=0.42, show_default=True, help="Of a stride [s].")
@click.option("--speed", type=float, default=0.3, show_default=True, help="Forwards [m/s].")
@click.option("--duration", type=float, default=10.0, show_default=True, help="Of the log [s].")
@click.option("--coulomb", type=float, default=0.2, show_default=True, help="In joints [N m].")
@click.option("--viscous", type=float, default=0.05, show_default=True, help="[N m s/rad].")
@click.option("--armature", type=float, default=0.0, show_default=True, help="[kg m²].")
@click.option("--torque-noise", type=float, default=0.1, show_default=True, help="[N m].")
@click.option("--dropped", type=float, default=0.005, show_default=True, help="Part of messages.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option(
    "--format",
    "formats",
    type=click.Choice(FORMATS),
    multiple=True,
    default=FORMATS,
    help="Of logs.",
)
def main(
    out: Path,
    gait: str,
    period: float,
    speed: float,
    duration: float,
    coulomb: float,
    viscous: float,
    armature: float,
    torque_noise: float,
    dropped: float,
    seed: int,
    formats: tuple[str, ...],
) -> None:
    """Simulate a walking Go2; write its logs and the true forces on its feet."""
    out.mkdir(parents=True, exist_ok=True)
    walk = Walk(
        duration=duration,
        gait=Gait(gait, period),
        aim=Aim(speed=speed),
        physics=Physics(coulomb=coulomb, viscous=viscous, armature=armature),
        seed=seed,
    )
    recording = walk.run()
    write_truth(recording, walk, out / "truth.nc")
    sensors = Sensors(torque_noise=torque_noise, dropped=dropped)
    write_logs(out, "exact", exact_log(recording), formats)
    write_logs(out, "realistic", realistic_log(recording, sensors, seed=seed), formats)
    click.echo(described(recording))
    click.echo(f"Written: {out}/truth.nc, exact and realistic logs ({', '.join(formats)})")


def write_logs(folder: Path, name: str, log: JointLog, formats: tuple[str, ...]) -> list[Path]:
    """Write one log in several formats.

    Parameters
    ----------
    folder, name
        Where, and the file's name without suffix.
    log
        The log.
    formats
        Some of :data:`FORMATS`.

    Returns
    -------
    list of Path
        What was written.
    """
    writers = {
        "csv": logs.write_csv,
        "parquet": logs.write_parquet,
        "mcap": logs.write_mcap,
        "rosbag2": logs.write_rosbag2,
    }
    paths = []
    for kind in formats:
        path = folder / (f"{name}-rosbag2" if kind == "rosbag2" else f"{name}.{kind}")
        writers[kind](path, log)
        paths.append(path)
    return paths


def described(recording: Recording) -> str:
    """How fast it walked and what it felt, in words."""
    duration = recording.time[-1]
    speed = (recording.position[-1, 0] - recording.position[0, 0]) / duration
    loaded = recording.force[:, :, 2] > 10.0
    sliding = np.linalg.norm(recording.foot_velocity[:, :, :2], axis=2)
    middle = np.median(sliding[loaded]) if loaded.any() else 0.0
    peaks = ", ".join(
        f"{foot} {peak:.0f} N"
        for foot, peak in zip(FEET, recording.force[..., 2].max(0), strict=True)
    )
    return (
        f"{duration:.1f} s at {speed:.3f} m/s; feet move at {middle:.3f} m/s (median) under load; "
        f"largest Fz: {peaks}"
    )


if __name__ == "__main__":
    main()
