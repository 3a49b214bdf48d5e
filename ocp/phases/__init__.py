"""Plans with phases of given contact nodes, linked by impacts.

All phases form one nonlinear program.
"""
