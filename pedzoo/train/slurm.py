"""Jobs of Slurm that run again, after a signal or a crash of their machine, and go on where they were."""

import json
import os
import subprocess
from pathlib import Path

_RECORD = "slurm"


def job_record() -> dict[str, dict[str, str | int]]:
    """Return what ``versions.json`` says of the job that this process is in; nothing outside of Slurm."""
    job = _job()
    return {_RECORD: {"job": job, "restarts": _restarts()}} if job else {}


def left_by_this_job(run: Path) -> bool:
    """Return whether the run in a folder was begun by this process' job before it was run again."""
    file, job = run / "versions.json", _job()
    if job is None or not file.is_file():
        return False
    try:
        record = json.loads(file.read_text())[_RECORD]
        return record["job"] == job and record["restarts"] < _restarts()
    except (ValueError, LookupError, TypeError):
        return False


def run_again() -> str:
    """Ask Slurm to run the job again, and return in words what came of it."""
    job = str(_job())
    try:
        asked = subprocess.run(
            ["scontrol", "requeue", job], capture_output=True, text=True, timeout=60, check=False
        )
        why = asked.stderr.strip() if asked.returncode else ""
    except (OSError, subprocess.TimeoutExpired) as error:
        why = str(error)
    return f"Slurm does not run job {job} again ({why})" if why else f"Slurm runs job {job} again"


def _job() -> str | None:
    """Return the number of the job, which it keeps when it is run again."""
    array = os.environ.get("SLURM_ARRAY_JOB_ID")
    return f"{array}_{os.environ.get('SLURM_ARRAY_TASK_ID')}" if array else os.environ.get("SLURM_JOB_ID")


def _restarts() -> int:
    """Return how often the job was run before."""
    return int(os.environ.get("SLURM_RESTART_COUNT") or 0)
