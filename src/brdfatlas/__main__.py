"""``python -m brdfatlas``: the command line."""

import sys

from brdfatlas.cli import main

if __name__ == "__main__":  # workers of a recommendation import it too
    sys.exit(main())
