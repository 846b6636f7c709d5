"""`python -m armadico` is `armadico`."""

import sys

from armadico.cli import main

sys.exit(main())
