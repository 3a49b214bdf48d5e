"""Planning problems of typical kinds, which examples/ocp_suite.py solves."""
