"""General tools: input checks, array files, CasADi helpers, compilation."""
