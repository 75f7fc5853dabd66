"""`uavtwin train`: a compensator of residuals that no named effect explains."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from twin.errors import TwinError

from .options import (
    Exit,
    Force,
    Json,
    Out,
    Prints,
    Rebuild,
    TrustVehicle,
    VehicleName,
    needed_vehicle,
    seconds,
)
from .printing import STDOUT, print_damage, print_json, print_sections, print_written, progress

if TYPE_CHECKING:
    from ..learned import TrainResult

LONGEST_HORIZON_S = 1.0
"""Longest horizon of a compensator with past residuals as inputs."""
Protocol = Literal["force", "reconstruct", "track", "free"]

ModelName = Annotated[
    str | None,
    typer.Option(
        help="svq: ours; linear: no network. Default: that of the preset, else svq; of free "
        "without --epochs linear."
    ),
]
PresetName = Annotated[
    str | None,
    typer.Option(help="Of svq: best: ours; paper: the paper's text; published: its code."),
]


def train(
    flights: Annotated[list[Path], typer.Argument(help="Logs or flight tables.")],
    vehicle: VehicleName = None,
    model: ModelName = None,
    preset: PresetName = None,
    protocol: Annotated[
        Protocol,
        typer.Option(
            help="force: force and moment inside the equations. Of the sensors: track: it sees "
            "residuals as old as the horizon; free: none; reconstruct: the present one, for "
            "comparison with the paper."
        ),
    ] = "track",
    horizon: Annotated[
        float | None,
        seconds("Of track, s: how old the residuals are that it sees. Default: one sample."),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Samples per second: 1000 over an integer. Default: of free that of the IMU, else "
            "100."
        ),
    ] = None,
    epochs: Annotated[int | None, typer.Option(min=1, help="Default: the preset's.")] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Of everything that is drawn. Default: the preset's, 0 in most."),
    ] = None,
    device: Annotated[
        Literal["cpu", "cuda", "auto"],
        typer.Option(
            help="Of the training; auto: a GPU where torch finds one. The same seed gives the same "
            "bytes on cpu alone."
        ),
    ] = "cpu",
    license: Annotated[
        str, typer.Option(help="Of the model, for its card: cc-by-4.0, or another identifier.")
    ] = "unknown",
    law: Annotated[
        Path | None,
        typer.Option(
            help="Of free: folder of a learned force. The sensors of the twin that has it are "
            "corrected, and the new folder holds both."
        ),
    ] = None,
    out: Out = Path("model"),
    rebuild_commands: Rebuild = None,
    trust_vehicle: TrustVehicle = False,
    force: Force = False,
    as_json: Annotated[Json, Prints("uavtwin.learned:TrainRecord")] = False,
) -> None:
    """Train a compensator on what a vehicle model leaves unexplained in flights.

    After an interruption the same command resumes the training.
    """

    from learning.data.flights import DEFAULT_RATE_HZ

    from ..flights import read_alike
    from ..learned import Wanted, check_extra_learn, run_train
    from ..output import write_run
    from ..vehicles import load_vehicle

    check_extra_learn()
    named = needed_vehicle(vehicle, "train")
    twin = load_vehicle(named)
    read = read_alike(flights, rebuild_commands, trust_vehicle)
    laws = () if law is None else (law / "force.json",)
    inputs = [p for p in (*flights, Path(named), *laws) if p.is_file()]

    def alongside(trained: "TrainResult", folder: Path) -> None:
        """Print the trained model, before the folder is moved to its place, and write run.json."""
        if as_json:
            print_json(trained.record)
        else:
            STDOUT.print(trained.claim, style="bold")
            print_sections(trained.tables)
        options = {
            "vehicle": Path(named).name,
            "rebuild_commands": rebuild_commands,
            "trust_vehicle": trust_vehicle,
            "license": license,
            "law": None if law is None else law.name,
            **trained.options,
        }
        write_run(folder, "train", options, inputs, trained.seed)

    samples = 1 if horizon is None else _samples(horizon, rate or DEFAULT_RATE_HZ)
    wanted = Wanted(model, preset, protocol, samples, rate, epochs, seed, device, license, law)
    with progress("training") as step:
        trained = run_train(read, twin, out, wanted, force, step, alongside)
    if not as_json:
        print_written(out, trained.files)
    if print_damage(read):
        raise typer.Exit(Exit.FINDINGS)


def _samples(horizon_s: float, rate_hz: float) -> int:
    """Number of samples of a horizon.

    Raises:
        TwinError: It is no integer, or the horizon is too long.
    """
    count = round(horizon_s * rate_hz) if 0 < horizon_s <= LONGEST_HORIZON_S else 0
    if count < 1 or abs(count - horizon_s * rate_hz) > 1e-6:
        raise TwinError(
            f"--horizon {horizon_s:g} s: needs a multiple of {1 / rate_hz:g} s, the time between "
            f"samples (--rate), up to {LONGEST_HORIZON_S:g} s."
        )
    return count
