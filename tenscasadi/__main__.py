"""Command line, run by `python -m tenscasadi`."""

from tenscasadi.cli.main import main

raise SystemExit(main())
