"""Runs programs that edit a dataset and annotations, kills them at random moments, and starts them again.

Usage: torture.py FOLDER EDITS KILLS SEED COMMAND...  (COMMAND starts an Elixir script)
"""

import os
import pathlib
import random
import subprocess
import sys
import time

here = pathlib.Path(__file__).parent
folder, edits, kills, seed, *command = sys.argv[1:]
folder, edits, kills, choose = pathlib.Path(folder), int(edits), int(kills), random.Random(int(seed))
study, store = folder / "study.json", folder / "shared" / "annotations"
study.write_text('{"version": 1, "name": "Torture", "sessions": [{"name": "shared", "partitions": []}]}\n')
names = [f"w{i}" for i in range(8)]
killed = dict.fromkeys(names, 0)
for name in names:
    (folder / name).write_text("")


def start(name):
    # Two of the programs are Python programs.
    script = [*command, str(here / "worker.exs")]
    if name in names[6:]:
        script = [sys.executable, str(here / "worker.py")]
    log = open(folder / f"{name}.log", "ab")
    arguments = [str(study), str(store), name, str(edits), str(folder / name)]
    client = {**os.environ, "PYTHONPATH": str(here.parent.parent / "clients" / "python" / "src")}
    return subprocess.Popen(script + arguments, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=client)


running = {name: start(name) for name in names}
left, next_kill, failed = kills, time.monotonic() + 1.5, False
while running:
    time.sleep(0.005)
    for name, process in list(running.items()):
        if process.poll() is not None:
            del running[name]
            if process.returncode:
                failed = True
                print(f"FAILED {name}: {(folder / f'{name}.log').read_text()[-2000:]}")
    busy = [name for name in running if (folder / name).stat().st_size > 0]
    if left and busy and time.monotonic() >= next_kill:
        name = choose.choice(busy)
        running[name].kill()
        running[name].wait()
        killed[name] += 1
        left -= 1
        next_kill = time.monotonic() + choose.uniform(0.02, 2 * edits / 100 / max(kills, 1) + 0.3)
        running[name] = start(name)
print(f"  8 programs, {kills - left} killed")
lists = []
for name in names:
    lists.append(folder / f"{name}.{killed[name]}")
    os.rename(folder / name, lists[-1])
done = subprocess.run([*command, str(here / "check.exs"), str(study), str(store), *map(str, lists)], check=False)
sys.exit(failed or done.returncode)
