"""`python -m tenscasadi`: the command line."""

from tenscasadi.cli.main import main

raise SystemExit(main())
