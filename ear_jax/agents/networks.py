"""Networks as pure functions of parameters and one item. The only file that uses Flax modules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
from flax import struct

from ear_jax.agents.matmul import bfloat16_matmul
from ear_jax.config import NetworkConfig

Params = Any
Initialiser = Literal["authors", "fan_in"]
Activation = Callable[[jax.Array], jax.Array]
BATCH = "batch"  # the name of a vmapped axis over whose items BatchNorm takes its statistics


@dataclass(frozen=True)
class Network:
    """One network: `init(key)` returns parameters, `apply(params, x)` maps one item x [in] to [out]."""

    init: Callable[[jax.Array], Params]
    apply: Callable[[Params, jax.Array], jax.Array]
    apply_in_batch: Callable[[Params, jax.Array], tuple[jax.Array, Params]] | None = None
    """As `apply`, for an item of a batch (a vmapped axis `BATCH`) that normalises it; also returns new statistics."""


def _uniform(bound: float) -> nn.initializers.Initializer:
    return lambda key, shape, dtype=jnp.float32: jax.random.uniform(key, shape, dtype, -bound, bound)


def _by_fan(axis: int) -> nn.initializers.Initializer:
    """Initialises a kernel [in, out] by U(±1/√fan); axis 0 is its fan-in, axis 1 its fan-out."""
    return lambda key, shape, dtype=jnp.float32: _uniform(shape[axis] ** -0.5)(key, shape, dtype)


def _direction(key: jax.Array, shape: tuple[int, ...], dtype: Any = jnp.float32) -> jax.Array:
    return unit_vector(jax.random.normal(key, shape, dtype))


def _rounded(x: jax.Array, kernel: jax.Array, *_: Any, **__: Any) -> jax.Array:
    """Stands in for `jax.lax.dot_general` in Dense, for one item x [in]."""
    return bfloat16_matmul(x, kernel)


class _Mlp(nn.Module):
    widths: tuple[int, ...]
    out: int
    config: NetworkConfig
    layer_norm: bool
    activation: Activation
    gathered: bool

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        authors = self.config.initialiser == "authors"
        kernel, last = (_by_fan(1), _uniform(3e-3)) if authors else (_by_fan(0), _by_fan(0))
        bias, last_bias = (nn.initializers.constant(0.1), last) if authors else (nn.initializers.zeros,) * 2
        if self.gathered:
            last, last_bias = _uniform(0.03), _direction
        rounded = None if self.config.matmul == "float32" else _rounded
        for width in self.widths:
            x = nn.Dense(width, kernel_init=kernel, bias_init=bias, dot_general=rounded)(x)
            if self.layer_norm:
                x = nn.LayerNorm()(x)
            x = self.activation(x)
        return nn.Dense(self.out, kernel_init=last, bias_init=last_bias)(x)


def mlp(
    size: int,
    widths: tuple[int, ...],
    out: int,
    config: NetworkConfig,
    layer_norm: bool = False,
    activation: Activation = jax.nn.relu,
    gathered: bool = False,
) -> Network:
    """Builds hidden layers of the given widths, ReLU by default, and a linear one, from `size` inputs to `out`.

    `config.initialiser` is `authors` (hidden weights U(±1/√fan_out), hidden biases 0.1, the last layer U(±3e-3)) or
    `fan_in` (all weights U(±1/√fan_in), all biases 0). With `gathered` the last layer's bias is a random unit vector
    and its weights are U(±0.03), so that outputs start close together. `config.matmul` is the precision of hidden
    layers; the last layer always multiplies float32.
    """
    module = _Mlp(widths, out, config, layer_norm, activation, gathered)
    return Network(
        lambda key: module.init(key, jnp.zeros(size)), lambda params, x: jnp.asarray(module.apply(params, x))
    )


class _Residual(nn.Module):
    width: int
    blocks: int
    out: int
    config: NetworkConfig

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        kernel = _by_fan(1 if self.config.initialiser == "authors" else 0)
        rounded = None if self.config.matmul == "float32" else _rounded

        def normalised(x: jax.Array) -> jax.Array:
            return nn.LayerNorm()(nn.Dense(self.width, kernel_init=kernel, dot_general=rounded)(x))

        x = jax.nn.relu(normalised(x))
        for _ in range(self.blocks):
            x = x + normalised(jax.nn.relu(normalised(x)))
        return nn.Dense(self.out, kernel_init=kernel)(x)


def residual(size: int, blocks: int, out: int, config: NetworkConfig) -> Network:
    """Builds BRO's critic network (Nauman et al. 2024, arXiv 2405.16158), from `size` inputs to `out`.

    A layer x ← ReLU(LN(Wx)), then blocks x ← x + LN(W₂ ReLU(LN(W₁x))), all of `config.width`, and a linear layer.
    """
    module = _Residual(config.width, blocks, out, config)
    return Network(
        lambda key: module.init(key, jnp.zeros(size)), lambda params, x: jnp.asarray(module.apply(params, x))
    )


class _BatchNormed(nn.Module):
    widths: tuple[int, ...]
    out: int
    config: NetworkConfig

    @nn.compact
    def __call__(self, x: jax.Array, in_batch: bool = False) -> jax.Array:
        axis, kernel = BATCH if in_batch else None, nn.initializers.orthogonal()
        rounded = None if self.config.matmul == "float32" else _rounded

        def normalised(x: jax.Array) -> jax.Array:
            return nn.BatchNorm(not in_batch, momentum=0.99, epsilon=1e-3, axis_name=axis)(x)

        x = normalised(x)
        for width in self.widths:
            x = jax.nn.relu(normalised(nn.Dense(width, use_bias=False, kernel_init=kernel, dot_general=rounded)(x)))
        return nn.Dense(self.out, kernel_init=kernel)(x)


def batch_normed(size: int, widths: tuple[int, ...], out: int, config: NetworkConfig) -> Network:
    """Builds XQC's critic network (Palenicek et al. 2025, arXiv 2509.25174), from `size` inputs to `out`.

    BatchNorm, then layers x ← ReLU(BN(Wx)), and a linear layer. `apply` normalises by running statistics, which are
    the parameters' collection `batch_stats`. `unit_columns` keeps the weights at unit norm, which begin orthogonal,
    whatever `config.initialiser` is.
    """
    module = _BatchNormed(widths, out, config)

    def apply_in_batch(params: Params, x: jax.Array) -> tuple[jax.Array, Params]:
        output, statistics = module.apply(params, x, True, mutable=["batch_stats"])
        return jnp.asarray(output), dict(statistics)

    return Network(
        lambda key: unit_columns(module.init(key, jnp.zeros(size))),
        lambda params, x: jnp.asarray(module.apply(params, x)),
        apply_in_batch,
    )


def unit_columns(params: Params) -> Params:
    """Divides the weights of every unit, a column of a kernel [in, out], by their norm."""

    def of_leaf(path: Any, leaf: jax.Array) -> jax.Array:
        return leaf / jnp.linalg.norm(leaf, axis=-2, keepdims=True) if is_kernel(path) else leaf

    return jax.tree_util.tree_map_with_path(of_leaf, params)


def is_kernel(path: Any) -> bool:
    """Returns whether the path of a leaf in parameters is that of a layer's weights."""
    return "kernel" in jax.tree_util.keystr(path)


def recurrent_layer(size: int, width: int, initialiser: Initialiser) -> Network:
    """Builds Elman's layer hₜ = tanh(W xₜ + U hₜ₋₁ + b), h₀ = 0, U orthogonal: [steps, size] → [steps, width]."""
    kernel = _by_fan(1 if initialiser == "authors" else 0)
    module = nn.RNN(nn.SimpleCell(width, kernel_init=kernel))
    return Network(
        lambda key: module.init(key, jnp.zeros((1, size))), lambda params, x: jnp.asarray(module.apply(params, x))
    )


@struct.dataclass
class Standardiser:
    """Statistics of observations; part of a policy's parameters, but not learnt by gradients."""

    mean: jax.Array  # [obs]
    scale: jax.Array  # [obs], 1 / standard deviation

    def __call__(self, obs: jax.Array) -> jax.Array:
        """Standardises an observation [obs], or several [n, obs]."""
        return (obs - jax.lax.stop_gradient(self.mean)) * jax.lax.stop_gradient(self.scale)


def identity(size: int) -> Standardiser:
    """Returns a standardiser that leaves observations [size] unchanged."""
    return Standardiser(jnp.zeros(size), jnp.ones(size))


def unit_vector(x: jax.Array) -> jax.Array:
    """Projects a vector [n] onto the unit sphere; its gradient stays finite at the origin."""
    return x * jax.lax.rsqrt(jnp.sum(x**2) + 1e-12)
