"""One Python program that edits a dataset, like worker.exs. Usage: worker.py STUDY.json STORE NAME EDITS ACKNOWLEDGED"""

import sys

import situ

path, _, name, edits, acknowledged = sys.argv[1:]
with open(acknowledged) as file:
    first = len(file.readlines())


def edit(n):
    """Makes the n-th edit and returns the line that acknowledges it. Repeats it if another program was faster."""
    dataset = situ.Dataset.open(path)
    key = f"{name}-{n}"
    if n % 3 == 0:
        if key not in dataset.sessions:
            dataset.add_session(key)
        line = f"session {key}"
    elif n % 3 == 1:
        if key not in dataset.document["tags"]:
            dataset.document["tags"].append(key)
        line = f"tag {key}"
    else:
        shared = dataset.sessions["shared"].metadata
        shared[name] = shared.get(name, 0) + 1
        line = f"count {name}"
    dataset.save()
    return line


with open(acknowledged, "a", buffering=1) as file:
    for n in range(first, int(edits)):
        file.write(edit(n) + "\n")
