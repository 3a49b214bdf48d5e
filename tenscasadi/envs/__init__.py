"""Tasks of control as environments of gymnasium, one or many at once. Import it by name; it needs ``pip install 'tenscasadi[gym]'``."""

from __future__ import annotations

from tenscasadi.envs.environments import TensegrityEnv, TensegrityVectorEnv
from tenscasadi.envs.task import Task, Transition

__all__ = ["Task", "TensegrityEnv", "TensegrityVectorEnv", "Transition"]
