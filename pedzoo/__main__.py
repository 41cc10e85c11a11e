"""``python -m pedzoo``."""

import sys

from pedzoo.cli.main import main

sys.exit(main())
