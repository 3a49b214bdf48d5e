"""Plans with their methods: replay, report, refinement, robustness, files."""
