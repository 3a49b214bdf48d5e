"""Control tasks as Gymnasium environments, single or vectorized.

Import it by name. It requires ``pip install 'tenscasadi[gym]'``.
"""

from __future__ import annotations

from tenscasadi.envs.environments import TensegrityEnv, TensegrityVectorEnv
from tenscasadi.envs.task import Task, Transition

__all__ = ["Task", "TensegrityEnv", "TensegrityVectorEnv", "Transition"]
