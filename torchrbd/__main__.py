"""Run ``python -m torchrbd``."""

import sys

from torchrbd.cli import main

sys.exit(main())
