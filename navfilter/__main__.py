"""``python -m navfilter`` is the command ``navfilter``."""

import sys

from navfilter.commands.cli import main

sys.exit(main())
