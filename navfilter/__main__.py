"""``python -m navfilter`` is the command ``navfilter``."""

import sys

from navfilter.cli import main

sys.exit(main())
