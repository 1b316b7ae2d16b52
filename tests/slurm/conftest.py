"""A real Slurm on this machine for the tests of the cluster profile: munged, slurmctld and slurmd of our own."""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

CONFIGURATION = """\
ClusterName=brdfatlas
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
SlurmctldPort={controller_port}
SlurmdPort={node_port}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
JobAcctGatherParams=OverMemoryKill
AccountingStorageType=accounting_storage/none
MinJobAge=3600
ReturnToService=2
SchedulerParameters=sched_interval=2
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory={memory} State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="session")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Starts Slurm, makes it this machine's for a while, stops what it started; yields the folder of its logs."""
    if os.geteuid() != 0:
        pytest.skip("a Slurm of our own needs root")
    path = os.environ["PATH"] + ":/usr/sbin:/sbin"
    programs = {name: shutil.which(name, path=path) for name in ("munged", "slurmctld", "slurmd", "sbatch")}
    if not all(programs.values()):
        pytest.skip(f"not installed: {', '.join(name for name, found in programs.items() if not found)}")
    # The plugin clears SLURM_CONF in a job, so srun looks where Debian's package does.
    system = Path("/etc/slurm/slurm.conf")
    if system.is_symlink() and not system.exists():
        system.unlink()  # of a test that was killed, and whose folder is gone
    if system.exists():
        pytest.skip(f"{system}: this machine has a Slurm already, and it is left alone")
    folder = tmp_path_factory.mktemp("slurm")
    (folder / "munge.key").write_bytes(os.urandom(1024))
    (folder / "munge.key").chmod(0o400)
    for name in ("state", "spool"):
        (folder / name).mkdir()
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20
    configuration = folder / "slurm.conf"
    configuration.write_text(
        CONFIGURATION.format(
            host=socket.gethostname().split(".")[0],
            folder=folder,
            controller_port=free_port(),
            node_port=free_port(),
            cpus=os.cpu_count(),
            memory=memory * 9 // 10,
        )
    )
    started: list[subprocess.Popen] = []

    def start(*command: str) -> None:
        with open(folder / "daemons.log", "a") as log:
            started.append(subprocess.Popen(command, stdout=log, stderr=log))

    system.parent.mkdir(exist_ok=True)
    system.symlink_to(configuration)
    try:
        munge = ("key", "pid", "seed", "log")
        options = [f"--{name}-file={folder}/munge.{name}" for name in munge] + [f"--socket={folder}/munge.socket"]
        start(programs["munged"], "--foreground", "--force", *options)
        wait_for(lambda: (folder / "munge.socket").exists(), folder)
        start(programs["slurmctld"], "-D", "-f", str(configuration))
        start(programs["slurmd"], "-D", "-f", str(configuration))
        wait_for(lambda: "idle" in output("sinfo", "--noheader", "--format=%T"), folder)
        yield folder
    finally:
        output("scancel", "--user=root")
        deadline = time.monotonic() + 20
        while output("squeue", "--noheader") and time.monotonic() < deadline:
            time.sleep(0.2)
        for process in reversed(started):
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        system.unlink()


def output(*command: str) -> str:
    """What a Slurm command prints; "" if it fails."""
    return subprocess.run(command, capture_output=True, text=True).stdout


def wait_for(condition, folder: Path, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            logs = "\n".join(f"{log.name}:\n{log.read_text()[-2000:]}" for log in folder.glob("*.log"))
            pytest.fail(f"Slurm does not start:\n{logs}")
        time.sleep(0.2)
