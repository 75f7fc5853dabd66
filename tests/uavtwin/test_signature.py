"""Detached signatures of minisign, that `check` holds against a key."""

from pathlib import Path

import minisign
import pytest
from cli_rig import run

from twin.vehicle_file import vehicle_text
from uavtwin.file_check import _signature


def test_a_signature_is_of_every_byte_and_of_the_key(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(vehicle_text("copter_default")[0])
    own, other = minisign.KeyPair.generate(), minisign.KeyPair.generate()
    for name, pair in (("own.pub", own), ("other.pub", other)):
        (tmp_path / name).write_bytes(bytes(pair.public_key))
    key = ("--key", tmp_path / "own.pub")
    assert "not signed: there is no mine.toml.minisig" in run(capsys, "check", file, *key)[1]
    signature = own.secret_key.sign(file.read_bytes(), trusted_comment="release 1")
    (tmp_path / "mine.toml.minisig").write_bytes(bytes(signature))
    code, said, _ = run(capsys, "check", file, *key)
    assert code == 0 and "by own.pub, 'release 1'" in said
    assert "not verified: give --key" in run(capsys, "check", file)[1]
    code, said, _ = run(capsys, "check", file, "--key", tmp_path / "other.pub")
    assert code == 1 and "is no signature of this file by other.pub" in said
    content = file.read_bytes()
    for place in (0, len(content) // 2, len(content) - 1):
        file.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        assert _signature(file, tmp_path / "own.pub")[1], place
    file.write_bytes(content)
    code, _, err = run(capsys, "check", file, "--key", file)
    assert code == 2 and "mine.toml: no public key of minisign" in err
