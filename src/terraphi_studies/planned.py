"""Studies of planned cases: what is finished, what is missing, and how it is simulated.

Such a study reads the finished cases of shipped plans, of which each is a file named by the hash of
its scenario, in the package's data and in a folder; what neither has is simulated on request and
kept in the folder. It measures what is there and says what is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from terraphi.experiment.documents import shipped_folder
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import held
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward.forecast import forecast
from terraphi.library.build import failed_cases, finished_cases, simulate_cases
from terraphi.library.cluster import pool
from terraphi.library.plan import BASE, Plan, label
from terraphi_studies import Progress

Name = TypeVar("Name")


@dataclass(frozen=True)
class Simulations:
    """Where finished cases are, and who simulates the others.

    Attributes
    ----------
    build
        Folder of further finished cases. What is neither shipped nor there is simulated first, and
        kept there; without a folder nothing is simulated.
    workers
        Processes to simulate on; 1 if not given.
    cluster
        Address of a Dask cluster to simulate on instead.
    progress
        Called with the number of finished cases of a plan, counting parts, and of all.

    Raises
    ------
    InputError
        If workers or a cluster are named, and no folder for what they simulate.
    """

    build: Path | None = None
    workers: int | None = None
    cluster: str | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        """Refuse workers or a cluster without a folder for what they simulate."""
        if (self.workers or self.cluster) and self.build is None:
            raise InputError("workers are for what is simulated: name a --build FOLDER")

    def histories(self, *plans: Plan, keep_failures: bool = False) -> dict[str, ForceHistory]:
        """Usable histories of plans, by the hash of their scenario.

        Parameters
        ----------
        *plans
            Their names are those of the folders of the shipped cases.
        keep_failures
            Whether a case that fails is no error; it is not tried again.

        Raises
        ------
        InputError
            If the workers cannot be had or the folder not be written, and if a simulation failed or
            was interrupted: the others are kept.
        """
        found: dict[str, ForceHistory] = {}
        for plan in plans:
            for folder in self._folders(plan.name):
                found |= finished_cases(folder)
        for plan in plans:
            failed = self.failures(plan.name) if keep_failures else {}
            waiting = {scenario.hash for scenario in plan.cases()} - found.keys() - failed.keys()
            if self.build is not None and waiting:
                found |= self._simulated(plan, self.build, found, failed, keep_failures)
        return found

    def failures(self, name: str) -> dict[str, str]:
        """Why cases of a plan failed, by the hash of their scenario."""
        return {key: why for f in self._folders(name) for key, why in failed_cases(f).items()}

    def _folders(self, name: str) -> list[Path]:
        return [shipped_folder("cases", name), *([self.build] if self.build else [])]

    def _simulated(
        self,
        plan: Plan,
        folder: Path,
        known: Mapping[str, ForceHistory],
        failed: Mapping[str, str],
        keep_failures: bool,
    ) -> dict[str, ForceHistory]:
        report = self.progress
        try:
            with held(folder), pool(self.workers, self.cluster, default=1) as running:
                finished, failures = simulate_cases(
                    plan,
                    folder,
                    known=known,
                    executor=running.executor,
                    progress=lambda done, total: report and report(running.counted(done), total),
                    memory=running.memory,
                    keep_failures=keep_failures,
                    known_failures=failed,
                )
        except KeyboardInterrupt:
            raise InputError(
                f"{folder}: interrupted; what was finished is kept there, and the same command "
                "goes on from there"
            ) from None
        for variant in plan.variants():
            if variant.scenario.hash in failures and not keep_failures:
                reason = failures[variant.scenario.hash]
                raise InputError(f"plan '{plan.name}': {label(variant)} failed: {reason}")
        return finished


def need_base(plan: Plan, finished: Mapping[str, ForceHistory]) -> None:
    """Raise InputError if a plan's base, with which all is compared, is not among the finished."""
    if plan.scenario.hash not in finished:
        raise InputError(
            f"plan '{plan.name}': its base, with which all is compared, is not simulated yet; "
            "--build FOLDER simulates what is missing"
        )


def steps_of(plan: Plan) -> dict[str, Scenario]:
    """Scenarios of a plan by the names of its steps; the base has its own."""
    return {
        plan.scenario.name if variant.key == BASE else variant.key: variant.scenario
        for variant in plan.variants()
    }


def missing_from(
    cases: Mapping[Name, Scenario], finished: Mapping[str, ForceHistory]
) -> dict[Name, Scenario]:
    """Those cases, by name, that are not finished."""
    return {name: scenario for name, scenario in cases.items() if scenario.hash not in finished}


def minutes_of(scenario: Scenario) -> float:
    """Time that a simulation would take on one core, roughly [min]."""
    return forecast([scenario]).seconds() / 60.0


def not_yet(study: str, missing: Mapping[str, Scenario]) -> list[str]:
    """A note on the cases that are not simulated yet, how long they take and who does it.

    Empty if there are none.
    """
    times = {name: minutes_of(scenario) for name, scenario in missing.items()}
    if not times:
        return []
    cases = ", ".join(f"{name} ({minutes:.0f} min)" for name, minutes in times.items())
    command = f"`terraphi study {study} --build FOLDER`"
    whole = f"{sum(times.values()):.0f} minutes of one core"
    return [f"Not simulated yet: {cases}; {command} does it in about {whole}."]
