"""Plans with contact phases, linked by impacts.

The contact nodes of each phase are given. All phases form one nonlinear program.
"""
