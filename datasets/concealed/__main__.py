"""``python -m twinbench.datasets.concealed --out DIR``, see ``labelled``."""

import sys

from .labelled import main

if __name__ == "__main__":
    sys.exit(main())
