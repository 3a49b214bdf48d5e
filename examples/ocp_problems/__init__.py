"""Problems that users of planners bring, by kind: what examples/ocp_suite.py solves."""
