"""Critics with LayerNorm as kernels: Q of a batch, and its gradients, each in one launch for all critics and seeds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Params
from ear_jax.fused.blocks import (
    Chunks,
    Pack,
    add,
    masked,
    normalised,
    normalised_back,
    product,
    relu,
    total,
    write,
    write_sums,
)
from ear_jax.fused.launch import BACKWARD_ROWS, FORWARD_ROWS, launch


@dataclass(frozen=True)
class CriticLayout:
    """Rows of a critic's pack: first weights, those of further layers, then bias, scale and shift of each layer."""

    inputs: int  # of the network, without padding
    width: int
    layers: int
    bfloat16: bool

    @property
    def padded(self) -> int:
        """Inputs of the kernels, a power of two."""
        return max(16, 1 << (self.inputs - 1).bit_length())

    @property
    def vectors(self) -> int:
        """The first row of vectors."""
        return self.padded + (self.layers - 1) * self.width

    @property
    def sums(self) -> int:
        """Rows of vectors: three for each layer, the last weights, and the last bias."""
        return 3 * self.layers + 2

    def weights(self, layer: int) -> int:
        """Returns the first row of a layer's weights."""
        return 0 if layer == 0 else self.padded + (layer - 1) * self.width

    def pack(self, params: Params) -> jax.Array:
        """Packs one critic's parameters, [rows, width]."""
        inner = params["params"]
        first, *others = (inner[f"Dense_{layer}"]["kernel"] for layer in range(self.layers))
        rows = [jnp.pad(first, ((0, self.padded - self.inputs), (0, 0))), *others]
        for layer in range(self.layers):
            norm = inner[f"LayerNorm_{layer}"]
            rows += [inner[f"Dense_{layer}"]["bias"][None], norm["scale"][None], norm["bias"][None]]
        last = inner[f"Dense_{self.layers}"]
        return jnp.concatenate([*rows, last["kernel"].T, jnp.pad(last["bias"][None], ((0, 0), (0, self.width - 1)))])

    def unpack(self, pack: jax.Array) -> Params:
        """Returns the parameters of one critic from its pack."""
        params: dict[str, Any] = {}
        for layer in range(self.layers):
            start, size = self.weights(layer), self.width if layer else self.inputs
            bias, scale, shift = pack[self.vectors + 3 * layer : self.vectors + 3 * layer + 3]
            params[f"Dense_{layer}"] = {"kernel": pack[start : start + size], "bias": bias}
            params[f"LayerNorm_{layer}"] = {"scale": scale, "bias": shift}
        params[f"Dense_{self.layers}"] = {"kernel": pack[-2][:, None], "bias": pack[-1, :1]}
        return {"params": params}


@dataclass(frozen=True)
class _Layer:
    """The values of a layer that its gradient needs."""

    inputs: Chunks
    standard: Chunks  # before scale and shift
    inverse: jax.Array
    outputs: Chunks  # before ReLU


def _forward(layout: CriticLayout, x: jax.Array, pack: Pack) -> list[_Layer]:
    layers, xs = [], [x]
    for layer in range(layout.layers):
        bias, scale, shift = (pack.vector(layout.vectors + 3 * layer + row) for row in range(3))
        standard, inverse = normalised(add(pack.widen(xs, layout.weights(layer)), bias), layout.width)
        outputs = [n * g + s for n, g, s in zip(standard, scale, shift, strict=True)]
        layers.append(_Layer(xs, standard, inverse, outputs))
        xs = relu(outputs)
    return layers


def _value_kernel(layout: CriticLayout, x: Any, pack_ref: Any, q: Any) -> None:
    pack = Pack(pack_ref, layout.width, layout.bfloat16)
    hidden = relu(_forward(layout, x[...], pack)[-1].outputs)
    last = pack.vector(layout.vectors + layout.sums - 2)
    value = total(jnp.sum(h * w, axis=1, keepdims=True) for h, w in zip(hidden, last, strict=True))
    q[...] = value + pack.narrow(layout.vectors + layout.sums - 1, 0, 1)


def _backward_kernel(layout: CriticLayout, by_params: bool, x: Any, dq: Any, pack_ref: Any, *results: Any) -> None:
    """Writes the gradient by inputs; or each layer's hidden input and gradient, and sums for the vectors."""
    pack = Pack(pack_ref, layout.width, layout.bfloat16)
    layers, grad = _forward(layout, x[...], pack), dq[...]
    weights = pack.vector(layout.vectors + layout.sums - 2)
    hidden, grads = relu(layers[-1].outputs), [grad * w for w in weights]
    sums = results[-1]
    if by_params:
        write_sums(sums, layout.sums - 2, [h * grad for h in hidden])
        write_sums(sums, layout.sums - 1, [jnp.broadcast_to(grad, h.shape) for h in hidden])
    for layer in reversed(range(layout.layers)):
        done, row = layers[layer], 3 * layer
        grads = masked(grads, done.outputs)
        scale = pack.vector(layout.vectors + row + 1)
        inner = normalised_back([g * s for g, s in zip(grads, scale, strict=True)], done.standard, done.inverse)
        if by_params:
            write_sums(sums, row, inner)
            write_sums(sums, row + 1, [g * n for g, n in zip(grads, done.standard, strict=True)])
            write_sums(sums, row + 2, grads)
            write(results[layer], inner)
            if layer:
                write(results[layout.layers + layer - 1], done.inputs)
        size = layout.width if layer else layout.padded
        grads = pack.widen_back(inner, layout.weights(layer), size) if layer or not by_params else []
    if not by_params:
        results[0][...] = grads[0]


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def values(layout: CriticLayout, pack: jax.Array, x: jax.Array) -> jax.Array:
    """Returns Q [n] of inputs [n, padded] for one critic."""
    q = launch(partial(_value_kernel, layout), "critic_forward", FORWARD_ROWS, [x], pack, [(1, jnp.float32)])[0]
    return q[:, 0]


def _values_fwd(layout: CriticLayout, pack: jax.Array, x: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    return values(layout, pack, x), (pack, x)


def _values_bwd(
    layout: CriticLayout, saved: tuple[jax.Array, jax.Array], grad: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Two launches, one for each gradient: the compiler drops the one that nobody asked for."""
    pack, x = saved
    dtype = jnp.bfloat16 if layout.bfloat16 else jnp.float32
    batched, depth = [x, grad[:, None]], layout.layers
    kernel = partial(_backward_kernel, layout)
    (by_input,) = launch(
        partial(kernel, False), "critic_input_gradient", BACKWARD_ROWS, batched, pack, [(layout.padded, jnp.float32)]
    )
    kept = [(layout.width, dtype)] * (2 * depth - 1)
    *found, sums = launch(partial(kernel, True), "critic_gradient", BACKWARD_ROWS, batched, pack, kept, layout.sums)
    inputs = [x.astype(dtype), *found[depth:]]
    rows = [weight_gradient(hidden, inner) for hidden, inner in zip(inputs, found[:depth], strict=True)]
    vectors = jnp.sum(sums, axis=0)
    bias = jnp.where(jnp.arange(layout.width) < 1, vectors[-1], 0.0)  # a single number, in a row of its own
    return jnp.concatenate([*rows, vectors[:-1], bias[None]]), by_input


values.defvjp(_values_fwd, _values_bwd)


def weight_gradient(inputs: jax.Array, grads: jax.Array) -> jax.Array:
    """Returns the gradient by weights [in, out], from a layer's inputs [n, in] and gradient [n, out]."""
    return product(inputs, grads, (((0,), (0,)), ((), ())))


def value_of_item(layout: CriticLayout) -> Any:
    """Returns a function (pack, x [inputs]) → Q of one item, which `vmap` over items makes one launch."""

    def of_batch(pack: jax.Array, x: jax.Array) -> jax.Array:
        return values(layout, pack, jnp.pad(x, ((0, 0), (0, layout.padded - layout.inputs))))

    @jax.custom_batching.custom_vmap
    def of_item(pack: jax.Array, x: jax.Array) -> jax.Array:
        return of_batch(pack, jnp.tile(x[None], (FORWARD_ROWS, 1)))[0]

    @of_item.def_vmap
    def _(size: int, batched: list[bool], pack: jax.Array, x: jax.Array) -> tuple[jax.Array, bool]:
        assert batched == [False, True], "a critic is applied to a batch at once"
        return of_batch(pack, x), True

    return of_item
