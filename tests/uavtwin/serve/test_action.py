"""The script of the action: a page for each log that a pull request brings."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT
from serve_rigs.sites import sound_log

SCRIPT = ROOT / ".github" / "actions" / "uavtwin" / "pages.sh"


def pages(folder: Path, **environment: str) -> tuple[int, str]:
    """Exit code and summary of a run in a folder."""
    summary = folder / "summary.md"
    own = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    own |= {"GITHUB_STEP_SUMMARY": str(summary), **environment}
    done = subprocess.run(
        ["bash", str(SCRIPT), str(folder / "out")],
        cwd=folder,
        env={**os.environ, **own},
        check=False,
    )
    return done.returncode, summary.read_text()


def test_without_logs_there_is_nothing_to_do(tmp_path: Path) -> None:
    code, summary = pages(tmp_path)
    assert code == 0 and "0 logs" in summary
    assert pages(tmp_path, FAIL_ON="anything")[0] == 2


@pytest.mark.long
def test_logs_of_a_pull_request_have_a_page_each(tmp_path: Path) -> None:
    git = ["git", "-c", "user.name=x", "-c", "user.email=x", "-C", str(tmp_path)]
    for command in (["init", "-q"], ["commit", "-q", "--allow-empty", "-m", "before"]):
        subprocess.run([*git, *command], check=True)
    (tmp_path / "a | <b>.ulg").write_bytes(b"no log at all")
    (tmp_path / "notes.txt").write_text("no log")
    sound_log(tmp_path, "sound.csv")
    subprocess.run([*git, "add", "-A"], check=True)
    subprocess.run([*git, "commit", "-q", "-m", "logs"], check=True)
    code, summary = pages(tmp_path, BASE="HEAD~1")
    assert code == 1 and "1 logs: 0 in which something went wrong, 1 that cannot" in summary
    assert "<b>" not in summary
    code, summary = pages(tmp_path, LOGS="sound.csv")
    assert code == 0 and "| `001-sound.csv` |" in summary
    assert (tmp_path / "out" / "001-sound.csv.html").stat().st_size > 100_000
