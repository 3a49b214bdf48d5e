"""`python -m tenscasadi`: the command line."""

from tenscasadi.cli import main

raise SystemExit(main())
