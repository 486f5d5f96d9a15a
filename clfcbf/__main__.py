"""``python -m clfcbf``: the command line."""

import sys

from clfcbf.cli import main

if __name__ == "__main__":
    sys.exit(main())
