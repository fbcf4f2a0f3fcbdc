"""Slurm's programs, as far as they are called: jobs are processes of this machine, with what Slurm says to them in the environment.

``install(folder)`` writes them; the folder then goes first into PATH. What sbatch is given is kept as ``ID.sh``.
"""

import sys
from pathlib import Path

SBATCH = """
import os, re, subprocess, sys
here = os.path.dirname(os.path.abspath(__file__))
text = open(sys.argv[-1]).read()
number = str(1000 + len([f for f in os.listdir(here) if f.endswith(".sh")]))
open(f"{here}/{number}.sh", "w").write(text)
array = re.search(r"--array=0-(\\d+)%", text)
for name in [f"{number}_{k}" for k in range(int(array[1]) + 1)] if array else [number]:
    open(f"{here}/{name}.queued", "w").close()
subprocess.Popen([sys.executable, f"{here}/controller", number], start_new_session=True, stdin=subprocess.DEVNULL,
                 stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
print("Submitted batch job", number)
"""
CONTROLLER = """
import os, re, subprocess, sys
from concurrent.futures import ThreadPoolExecutor
here, number = os.path.dirname(os.path.abspath(__file__)), sys.argv[1]
array = re.search(r"--array=0-(\\d+)%(\\d+)", open(f"{here}/{number}.sh").read())
count, limit = (int(array[1]) + 1, int(array[2])) if array else (1, 1)

def run(k):
    name = f"{number}_{k}" if array else number
    said = {"SLURM_JOB_ID": number, "SLURM_NTASKS": "1", "SLURM_JOB_NUM_NODES": "1", "SLURM_NODEID": "0", "SLURM_PROCID": "0"}
    said |= {"SLURM_LOCALID": "0", "SLURM_CPUS_PER_TASK": "1"}
    said |= {"SLURM_ARRAY_JOB_ID": number, "SLURM_ARRAY_TASK_ID": str(k)} if array else {}
    if os.path.exists(f"{here}/{number}.cancelled"):
        open(f"{here}/{name}.state", "w").write("CANCELLED")
        return
    started = subprocess.Popen(["bash", f"{here}/{number}.sh"], env=os.environ | said, start_new_session=True)
    open(f"{here}/{name}.pid", "w").write(str(started.pid))
    code = started.wait()
    open(f"{here}/{name}.state", "w").write("COMPLETED" if code == 0 else "NODE_FAIL" if code > 128 else "FAILED")

with ThreadPoolExecutor(limit) as pool:
    list(pool.map(run, range(count)))
"""
SRUN = """
import os, sys
words = sys.argv[1:]
while words[0].startswith("--"):
    words = words[2:] if words[0] in ("--output", "--error") else words[1:]
os.execvp(words[0], words)
"""
SQUEUE = """
import os, sys
here = os.path.dirname(os.path.abspath(__file__))
asked = set(next(word for word in sys.argv if word.startswith("--jobs="))[7:].split(","))
for file in os.listdir(here):
    name, _, kind = file.partition(".")
    if kind == "queued" and name.partition("_")[0] in asked and not os.path.exists(f"{here}/{name}.state"):
        print(name)
"""
SCONTROL = """
import os, sys
here = os.path.dirname(os.path.abspath(__file__))
print(f"JobId={sys.argv[-1]} JobState={open(f'{here}/{sys.argv[-1]}.state').read()} Reason=None")
"""
SCANCEL = """
import os, signal, sys
here = os.path.dirname(os.path.abspath(__file__))
for number in sys.argv[1:]:
    open(f"{here}/{number}.cancelled", "w").close()
    for file in os.listdir(here):
        if file.endswith(".pid") and file[:-4].partition("_")[0] == number and not os.path.exists(f"{here}/{file[:-4]}.state"):
            os.killpg(int(open(f"{here}/{file}").read()), signal.SIGTERM)
"""


PROGRAMS = {"sbatch": SBATCH, "srun": SRUN, "squeue": SQUEUE, "scontrol": SCONTROL, "scancel": SCANCEL, "controller": CONTROLLER}


def install(folder):
    """Write the programs into ``folder``."""
    for name, source in PROGRAMS.items():
        file = Path(folder) / name
        file.write_text(f"#!{sys.executable}\n{source}")
        file.chmod(0o755)
