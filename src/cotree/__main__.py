"""``python -m cotree``: the command line."""

from __future__ import annotations

import sys

from cotree.cli import main

sys.exit(main())
