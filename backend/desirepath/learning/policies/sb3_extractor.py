"""The two-branch feature extractor as a Stable-Baselines3 class.

Alone in its file, importing nothing of ours, because exported zips carry this module's class by value.
"""

from __future__ import annotations

import gymnasium
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor


class TwoBranchExtractor(BaseFeaturesExtractor):
    """Task part and lidar part each through two ReLU layers, then joined (thesis 6.3.2.1)."""

    def __init__(self, observation_space: gymnasium.spaces.Box, task_inputs: int, width: int) -> None:
        super().__init__(observation_space, features_dim=2 * width)
        self.task_inputs = task_inputs
        lidar_inputs = observation_space.shape[0] - task_inputs
        self.task = self._branch(task_inputs, width)
        self.lidar = self._branch(lidar_inputs, width)

    @staticmethod
    def _branch(inputs: int, width: int) -> torch.nn.Sequential:
        return torch.nn.Sequential(
            torch.nn.Linear(inputs, width), torch.nn.ReLU(), torch.nn.Linear(width, width), torch.nn.ReLU()
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        task, lidar = observations[:, : self.task_inputs], observations[:, self.task_inputs :]
        return torch.cat([self.task(task), self.lidar(lidar)], dim=1)
