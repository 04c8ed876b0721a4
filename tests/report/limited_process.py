# SPDX-License-Identifier: AGPL-3.0-or-later
"""A process under limits of time and memory, and what it cost."""
import dataclasses
import os
import resource
import signal
import subprocess
import tempfile
import time


@dataclasses.dataclass
class Ended:
    """`fate`: ok, refused (exit 3), crash, time, memory, or `exit N`."""
    fate: str
    line: str  # the last error on stderr
    lines: int  # of stderr, less warnings
    warnings: list
    output: str
    wall: float  # s
    processor: float  # s, user and system
    peak_mib: float  # resident


def run_limited(command, seconds=120, gibibytes=6.0):
    """Runs a command to its end, or to the end of what it may take, with every process that it started."""
    limit = int(gibibytes * 2**30)

    def confine():
        # Address space is more than is resident: a stage that stays below it stays below the limit.
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        started = time.monotonic()
        process = subprocess.Popen([str(word) for word in command], stdin=subprocess.DEVNULL, stdout=output, stderr=errors,
                                   preexec_fn=confine, start_new_session=True)
        late = False
        try:
            while True:
                pid, status, usage = os.wait4(process.pid, os.WNOHANG)
                if pid:
                    break
                if not late and time.monotonic() - started > seconds:
                    late = True
                    os.killpg(process.pid, signal.SIGKILL)
                time.sleep(0.005)
            wall = time.monotonic() - started
            process.returncode = os.waitstatus_to_exitcode(status)
        finally:  # Whatever still runs of it, or where we are stopped ourselves.
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        output.seek(0), errors.seek(0)
        printed = output.read().decode(errors="replace")
        said = errors.read().decode(errors="replace").strip().splitlines()
    code, peak = process.returncode, usage.ru_maxrss / 1024
    warnings = [line.split(": warning: ", 1)[1] for line in said if ": warning: " in line]
    faults = [line for line in said if ": warning: " not in line]
    line = faults[-1] if faults else ""
    if late:
        fate = "time"
    elif peak > gibibytes * 1024 or (code == 3 and "memory" in line):
        fate = "memory"
    elif code < 0:
        fate = "crash"
        line = line or signal.Signals(-code).name
    else:
        fate = {0: "ok", 3: "refused"}.get(code, "exit %d" % code)
    return Ended(fate, line, len(faults), warnings, printed, wall, usage.ru_utime + usage.ru_stime, peak)
