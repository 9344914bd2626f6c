"""The same update in plain PyTorch; `benchmarks.peers` runs it in a virtual environment of its own.

    python peer_torch.py SETTINGS

SETTINGS is a JSON object: sizes of the networks and the batch, `updates` to time, and `bf16`; on a GPU also `device`,
`cuda`, `compile`, to compile the networks, and `repeats`. Prints milliseconds per update: of each repeat, and their
median. Batches are prepared beforehand: sampling them is not compared.
"""

from __future__ import annotations

import copy
import json
import statistics
import sys
import time
from typing import Any

import torch
from torch import nn
from torch.nn import functional

DRAWS = 4  # batches used in turn


def mlp(inputs: int, width: int, layers: int, outputs: int, layer_norm: bool = False) -> nn.Sequential:
    parts: list[nn.Module] = []
    for index in range(layers):
        parts.append(nn.Linear(width if index else inputs, width))
        if layer_norm:
            parts.append(nn.LayerNorm(width))
        parts.append(nn.ReLU())
    return nn.Sequential(*parts, nn.Linear(width if layers else inputs, outputs))


class Policy(nn.Module):
    """EAR's policy: a decoder of the sensory embedding and the task embedding, both of unit length."""

    def __init__(self, s: dict[str, Any]):
        super().__init__()
        self.encoder = mlp(s["obs"], s["width"], s["encoder_layers"], s["lse_size"])
        self.task_encoder = nn.Linear(s["tasks"], s["lte_size"])
        self.decoder = mlp(s["lse_size"] + s["lte_size"], s["width"], s["decoder_layers"], 2 * s["act"])
        self.noise = s["lte_noise"]

    def forward(self, obs: torch.Tensor, task: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        lte = functional.normalize(self.task_encoder(task), dim=-1)
        lte = functional.normalize(lte + self.noise * torch.randn_like(lte), dim=-1)
        lse = functional.normalize(self.encoder(obs), dim=-1)
        mean, log_std = self.decoder(torch.cat([lse, lte], -1)).chunk(2, -1)
        log_std = log_std.clamp(-20, 2)
        noise = torch.randn_like(mean)
        raw = mean + log_std.exp() * noise
        log_prob = -0.5 * noise**2 - log_std - 0.9189385
        log_prob = log_prob - 2 * (0.6931472 - raw - functional.softplus(-2 * raw))
        return raw.tanh(), log_prob.sum(-1)


class Update:
    """One gradient step of critics, policy and temperature."""

    def __init__(self, s: dict[str, Any]):
        inputs = s["obs"] + s["act"] + s["tasks"]
        self.s, self.policy = s, Policy(s)
        self.critics = nn.ModuleList(
            mlp(inputs, s["width"], s["critic_layers"], 1, s["critic_layer_norm"]) for _ in range(2)
        )
        self.targets = copy.deepcopy(self.critics)
        if s.get("compile"):
            for network in (self.policy, *self.critics, *self.targets):
                network.compile()
        self.log_temperature = torch.zeros((), requires_grad=True)
        groups = (self.policy.parameters(), *(critic.parameters() for critic in self.critics), [self.log_temperature])
        self.optimisers = [torch.optim.Adam(list(group), lr=s["lr"], foreach=True) for group in groups]

    def __call__(self, batch: tuple[torch.Tensor, ...]) -> None:
        obs, action, reward, next_obs, going, task = batch
        temperature = self.log_temperature.exp().detach()
        with torch.autocast(self.s.get("device", "cpu"), dtype=torch.bfloat16, enabled=self.s["bf16"]):
            with torch.no_grad():
                next_action, next_log_prob = self.policy(next_obs, task)
                value = self.value(self.targets, next_obs, next_action, task).min(0).values
                target = reward + self.s["discount"] * going * (value - temperature * next_log_prob)
            critic_loss = 0.5 * ((self.value(self.critics, obs, action, task) - target) ** 2).mean(-1).sum()
            new_action, log_prob = self.policy(obs, task)
            for parameter in self.critics.parameters():
                parameter.requires_grad_(False)
            value = self.value(self.critics, obs, new_action, task).min(0).values
            policy_loss = (temperature * log_prob - value).mean()
            for parameter in self.critics.parameters():
                parameter.requires_grad_(True)
        temperature_loss = -(self.log_temperature * (log_prob.detach() - self.s["act"])).mean()
        for optimiser in self.optimisers:
            optimiser.zero_grad()
        (critic_loss + policy_loss + temperature_loss).backward()
        for optimiser in self.optimisers:
            nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], self.s["max_grad_norm"])
            optimiser.step()
        with torch.no_grad():
            torch._foreach_lerp_(list(self.targets.parameters()), list(self.critics.parameters()), self.s["tau"])

    def value(self, critics: Any, obs: torch.Tensor, action: torch.Tensor, task: torch.Tensor) -> torch.Tensor:
        inputs = torch.cat([obs, action, task], -1)
        return torch.stack([critic(inputs)[..., 0] for critic in critics])


def batches(s: dict[str, Any]) -> list[tuple[torch.Tensor, ...]]:
    n = s["batch_size"]
    task = torch.eye(s["tasks"]).repeat_interleave(n // s["tasks"], 0)
    obs, action, going = torch.randn(DRAWS, n, s["obs"]), torch.rand(DRAWS, n, s["act"]) * 2 - 1, torch.ones(n)
    return [(obs[i], action[i], torch.randn(n), torch.randn(n, s["obs"]), going, task) for i in range(DRAWS)]


def main() -> None:
    s = json.loads(sys.argv[1])
    device = s.get("device", "cpu")
    torch.set_default_device(device)
    torch.backends.cuda.matmul.allow_tf32 = True  # as XLA does by default
    torch.manual_seed(0)
    wait = torch.cuda.synchronize if device == "cuda" else lambda: None
    update, data = Update(s), batches(s)
    for index in range(5):
        update(data[index % DRAWS])
    wait()
    each = []
    for _ in range(s.get("repeats", 1)):
        began = time.perf_counter()
        for index in range(s["updates"]):
            update(data[index % DRAWS])
        wait()
        each.append(1e3 * (time.perf_counter() - began) / s["updates"])
    print(json.dumps({"ms": statistics.median(each), "each_ms": each, "version": torch.__version__}))


if __name__ == "__main__":
    main()
