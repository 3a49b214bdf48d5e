"""Tools that know nothing of tensegrity: checks of input, files of arrays, CasADi helpers, compilation."""
