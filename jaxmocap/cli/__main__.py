"""``python -m jaxmocap.cli``: the command itself."""

import sys

from jaxmocap.cli import main

sys.exit(main())
