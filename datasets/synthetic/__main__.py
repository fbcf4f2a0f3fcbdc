"""``python -m twinbench.datasets.synthetic OUT``: write every synthetic recording below OUT, as the shipped sample was written."""

from __future__ import annotations

import argparse
from pathlib import Path

from .generate import SCENES, generate, write


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(prog="python -m twinbench.datasets.synthetic", description=__doc__)
    parser.add_argument("out", type=Path, help="folder for the recordings; recordings of the same names in it are replaced")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    for name in SCENES:
        recording = generate(name, seed=options.seed)
        write(recording, options.out / name, overwrite=True)
        counts = "{} tracked, {} surface and {} interior points".format(*recording.scenario.counts)
        print(f"{options.out / name}: {recording.scenario.frame_count} frames, {counts}")


if __name__ == "__main__":
    main()
