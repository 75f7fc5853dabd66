"""One rotation: explain, learn, export, fly."""

import hashlib
import shutil
import time
import zlib
from contextlib import closing
from pathlib import Path
from typing import Any

import learning
import twin
import uavtwin
from learning.force.model import load_force
from twin.explain.explanation import explain
from uavtwin.explanation import explained_vehicle
from uavtwin.force.evaluate import evaluate_force
from uavtwin.force.memory import Memory, training_key
from uavtwin.force.train import force_claim, train_force
from uavtwin.vehicles import Vehicle

from .closed_loop import closed_loop
from .rotations import Places, Rotation

SEED = 0
FLIGHTS = 13
"""In closed loop, in wind and in still air, of a rotation."""


def measure(rotation: Rotation, places: Places) -> dict[str, Any]:
    """Everything the page needs to know about one rotation, as JSON content."""
    start = time.perf_counter()
    taught, flown, physics = rotation.read(places)
    found = explain(taught, flown, physics, missions=(), indoors=rotation.indoors)
    vehicle, named = explained_vehicle(found), list(found.effects)
    folder = places.work / "models" / f"{rotation.group}.{rotation.name}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    checkpoint = folder.with_name(f"{folder.name}.jsonl")
    with closing(Memory(checkpoint, training_key(taught, vehicle, SEED))) as memory:
        train_force(taught, vehicle, SEED, folder, memory, lambda _: None)
    checkpoint.unlink()
    trained = time.perf_counter()
    before = Vehicle.of(physics) if named else None
    said = evaluate_force(folder, flown, before, lambda _: None).json()
    return {
        "group": rotation.group,
        "name": rotation.name,
        "named": named,
        "taught": [f.name for f in taught],
        "claim": force_claim(folder),
        "ridge": load_force(folder).ridge,
        "evaluation": said,
        "closed_loop": closed_loop(folder, FLIGHTS, zlib.crc32(rotation.name.encode())),
        "seconds": {
            "learned": round(trained - start, 1),
            "all": round(time.perf_counter() - start, 1),
        },
    }


def key(rotation: Rotation, places: Places) -> str:
    """Name of a rotation and hash of all that it depends on, the sources included."""
    digest = hashlib.sha256()
    for package in (twin, learning, uavtwin):
        root = Path(next(iter(package.__path__)))
        for file in sorted(root.rglob("*.py")):
            digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    taught, flown = rotation.files(places)
    for file in (Path(__file__), *taught, *flown):
        digest.update(file.read_bytes())
    return f"{rotation.group}.{rotation.name}.{digest.hexdigest()[:12]}"
