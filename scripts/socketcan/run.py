"""Run a command where there is a CAN interface vcan0, on a machine that may have none.

    python scripts/socketcan/run.py [--timeout S] -- COMMAND [ARGUMENT ...]

With kernel CAN the command runs in a network namespace of its own, so no interface of the host is touched; without it,
inside Debian's user-mode Linux, an ordinary process that boots on this file system in a few seconds. stderr says which.
Exit status: the command's; 77 when neither is possible here (the last line says why and what would change it);
76 when the chosen one failed to start; 75 when the time ran out.
"""

import argparse
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

INIT = Path(__file__).resolve().with_name("init.sh")
WIDE_REGISTERS = Path(__file__).resolve().with_name("wide_registers.c")
TIMED_OUT, BROKEN, IMPOSSIBLE = 75, 76, 77
MEMORY = "1G"  # of the user-mode kernel; taken from the host as it is used
MODULES = Path("/usr/lib/uml/modules")
INSTALL = "apt-get install -y user-mode-linux kmod iproute2"
UP = "ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 txqueuelen 1000 && ip link set vcan0 up"


def namespace() -> list[str]:
    """The prefix that runs a command in a network namespace of its own, where interfaces may be made."""
    return ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--user", "--map-root-user", "--net"]


def kernel_has_can() -> bool:
    """Whether this kernel makes a vcan interface when asked."""
    if not shutil.which("unshare") or not shutil.which("ip"):
        return False
    if os.geteuid() == 0 and shutil.which("modprobe"):
        subprocess.run(["modprobe", "-q", "vcan"], capture_output=True, check=False)
    return subprocess.run([*namespace(), "sh", "-c", UP], capture_output=True, check=False).returncode == 0


def wide_registers(job: Path) -> dict[str, str]:
    """The environment in which user-mode Linux 6.1 starts on a processor whose registers are wider than it knows."""
    if " amx_tile" not in Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace"):
        return {}
    library = job / "wide_registers.so"
    build = ["cc", "-shared", "-fPIC", "-O2", "-o", str(library), str(WIDE_REGISTERS), "-ldl"]
    if not shutil.which("cc") or subprocess.run(build, check=False).returncode != 0:
        print(
            "socketcan: this processor needs wide_registers.c, and it cannot be built (is there a cc?)", file=sys.stderr
        )
        return {}
    return {"LD_PRELOAD": str(library)}


def environment() -> dict[str, str]:
    """What the command inside gets of the environment outside."""
    kept = ("PATH", "HOME", "LANG", "VIRTUAL_ENV", "TMPDIR", "PYTHONPATH")
    return {name: value for name, value in os.environ.items() if name in kept or name.startswith(("RETUNER_", "COV"))}


def told(job: Path, *, timed_out: bool) -> int:
    """Replay stdout and stderr of the command, as far as it came; its status."""
    for name, stream in (("stdout", sys.stdout), ("stderr", sys.stderr)):
        if (job / name).exists():
            stream.write((job / name).read_text(errors="replace"))
    if timed_out:
        return TIMED_OUT
    status = job / "status"
    if not status.exists() or not status.read_text().strip():
        logs = [
            (job / name).read_text(errors="replace")[-2000:]
            for name in ("boot.log", "console")
            if (job / name).exists()
        ]
        print("socketcan: user-mode Linux ended without a status\n", *logs, file=sys.stderr)
        return BROKEN
    return int(status.read_text())


def wait(process: "subprocess.Popen[bytes]", timeout_s: float) -> int:
    """Wait for a process; end its whole session when the time runs out or somebody interrupts."""
    try:
        return process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        print(f"socketcan: not done after {timeout_s:g} s", file=sys.stderr)
        return TIMED_OUT
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def main() -> int:
    """Choose a way and take it."""
    parser = argparse.ArgumentParser(description="Run a command where there is a vcan0.")
    parser.add_argument("--timeout", type=float, default=300.0, metavar="S", help="seconds until it is ended (300)")
    parser.add_argument("--uml", action="store_true", help="use user-mode Linux even where the kernel has CAN")
    parser.add_argument("command", nargs="+", help="the command and its arguments, after --")
    chosen = parser.parse_args()
    if not chosen.uml and kernel_has_can():
        print("socketcan: vcan0 of this kernel, in a network namespace", file=sys.stderr)
        script = f"ip link set lo up; {UP} || exit {BROKEN}; exec {shlex.join(chosen.command)}"
        process = subprocess.Popen([*namespace(), "sh", "-c", script], start_new_session=True)
        return wait(process, chosen.timeout)
    kernel = shutil.which("linux.uml") if MODULES.is_dir() and shutil.which("insmod") and shutil.which("ip") else None
    if kernel is not None:
        print(f"socketcan: vcan0 inside user-mode Linux ({kernel})", file=sys.stderr)
        with tempfile.TemporaryDirectory(prefix="retuner-uml-") as folder:
            job = Path(folder)
            exports = "".join(f"export {name}={shlex.quote(value)}\n" for name, value in environment().items())
            (job / "command.sh").write_text(
                f"cd {shlex.quote(str(Path.cwd()))}\n{exports}exec {shlex.join(chosen.command)}\n"
            )
            init = job / "init.sh"
            shutil.copy(INIT, init)
            init.chmod(0o755)
            with (job / "console").open("wb") as console:
                process = subprocess.Popen(
                    [
                        kernel,
                        f"mem={MEMORY}",
                        "rootfstype=hostfs",
                        "rw",
                        f"init={init}",
                        f"JOB={job}",
                        "con=null",
                        "con0=fd:0,fd:1",
                        "quiet",
                    ],
                    stdin=subprocess.DEVNULL,
                    stdout=console,
                    stderr=console,
                    env={**os.environ, **wide_registers(job)},
                    start_new_session=True,
                )
                status = wait(process, chosen.timeout)
            return told(job, timed_out=status == TIMED_OUT)
    print(f"socketcan: this kernel makes no vcan and user-mode Linux is not installed; `{INSTALL}`", file=sys.stderr)
    return IMPOSSIBLE


if __name__ == "__main__":
    sys.exit(main())
