"""EAR's policy as kernels: the decoder's output for a batch and its gradients, each in one launch for all seeds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from ear_jax.agents.networks import Params
from ear_jax.fused.blocks import Chunks, Pack, add, masked, relu, write, write_sums
from ear_jax.fused.critic import weight_gradient
from ear_jax.fused.launch import BACKWARD_ROWS, FORWARD_ROWS, launch

SPHERE_EPSILON = 1e-12  # of `unit_vector`


def padded(size: int) -> int:
    """Returns the least power of two that holds a size, at least 16, the least that Triton multiplies."""
    return max(16, 1 << (size - 1).bit_length())


@dataclass(frozen=True)
class PolicyLayout:
    """Rows of a policy's pack: the encoder's weights, the decoder's, then a row for each bias."""

    obs: int  # sizes without padding
    lse: int
    code: int
    outputs: int
    width: int
    encoder_layers: int
    decoder_layers: int
    on_sphere: bool  # the LSE is normalised
    bfloat16: bool

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Sizes of observation, LSE, code and output in the kernels."""
        obs, lse, code, outputs = (padded(size) for size in (self.obs, self.lse, self.code, self.outputs))
        return obs, lse, code, outputs

    def encoder(self, layer: int) -> int:
        """Returns the first row of an encoder's layer; the last is the LSE's."""
        return 0 if layer == 0 else self.sizes[0] + (layer - 1) * self.width

    def decoder(self, layer: int) -> int:
        """Returns the first row of a decoder's layer; the first layer has rows for the LSE, then for the code."""
        _, lse, code, _ = self.sizes
        start = self.encoder(self.encoder_layers) + lse
        return start if layer == 0 else start + lse + code + (layer - 1) * self.width

    @property
    def biases(self) -> int:
        """The first of the rows of biases: a row each of encoder and decoder, and one of LSE and output together."""
        return self.decoder(self.decoder_layers) + self.sizes[3]

    def pack(self, networks: Params) -> jax.Array:
        """Packs a policy's encoder and decoder, [rows, width]."""
        encoder, decoder = networks["encoder"]["params"], networks["decoder"]["params"]
        obs, lse, code, outputs = self.sizes
        first = decoder["Dense_0"]["kernel"]
        rows = [
            _tall(encoder["Dense_0"]["kernel"], obs),
            *(encoder[f"Dense_{layer}"]["kernel"] for layer in range(1, self.encoder_layers)),
            _tall(encoder[f"Dense_{self.encoder_layers}"]["kernel"].T, lse),
            _tall(first[: self.lse], lse),
            _tall(first[self.lse :], code),
            *(decoder[f"Dense_{layer}"]["kernel"] for layer in range(1, self.decoder_layers)),
            _tall(decoder[f"Dense_{self.decoder_layers}"]["kernel"].T, outputs),
            *(encoder[f"Dense_{layer}"]["bias"][None] for layer in range(self.encoder_layers)),
            *(decoder[f"Dense_{layer}"]["bias"][None] for layer in range(self.decoder_layers)),
        ]
        narrow = self._narrow_row(
            encoder[f"Dense_{self.encoder_layers}"]["bias"], decoder[f"Dense_{self.decoder_layers}"]["bias"]
        )
        return jnp.concatenate([*rows, narrow[None]])

    def _narrow_row(self, lse: jax.Array, outputs: jax.Array) -> jax.Array:
        """Returns the row [width] of the biases of LSE and output."""
        gap = self.sizes[1] - len(lse)
        row = jnp.concatenate([lse, jnp.zeros(gap), outputs])
        return jnp.pad(row, (0, self.width - len(row)))

    def unpack(self, pack: jax.Array) -> Params:
        """Returns encoder and decoder from a pack."""
        bias, narrow = self.biases, pack[-1]
        encoder = {
            f"Dense_{layer}": {
                "kernel": pack[self.encoder(layer) :][: self.width if layer else self.obs],
                "bias": pack[bias + layer],
            }
            for layer in range(self.encoder_layers)
        }
        encoder[f"Dense_{self.encoder_layers}"] = {
            "kernel": pack[self.encoder(self.encoder_layers) :][: self.lse].T,
            "bias": narrow[: self.lse],
        }
        first = pack[self.decoder(0) :]
        kernels = [jnp.concatenate([first[: self.lse], first[self.sizes[1] :][: self.code]])]
        kernels += [pack[self.decoder(layer) :][: self.width] for layer in range(1, self.decoder_layers)]
        bias += self.encoder_layers
        decoder = {f"Dense_{layer}": {"kernel": k, "bias": pack[bias + layer]} for layer, k in enumerate(kernels)}
        decoder[f"Dense_{self.decoder_layers}"] = {
            "kernel": pack[self.decoder(self.decoder_layers) :][: self.outputs].T,
            "bias": narrow[self.sizes[1] :][: self.outputs],
        }
        return {"encoder": {"params": encoder}, "decoder": {"params": decoder}}


def _tall(weights: jax.Array, rows: int) -> jax.Array:
    return jnp.pad(weights, ((0, rows - len(weights)), (0, 0)))


@dataclass(frozen=True)
class _Pass:
    """The values of a forward pass that gradients need."""

    encoder: list[Chunks]  # before ReLU
    inverse: jax.Array  # 1 / length of the LSE before the sphere, [rows, 1]
    lse: jax.Array  # [rows, lse]
    decoder: list[Chunks]  # before ReLU


def _forward(layout: PolicyLayout, x: jax.Array, code: jax.Array, pack: Pack) -> _Pass:
    encoder: list[Chunks] = []
    decoder: list[Chunks] = []
    xs = [x]
    for layer in range(layout.encoder_layers):
        encoder.append(add(pack.widen(xs, layout.encoder(layer)), pack.vector(layout.biases + layer)))
        xs = relu(encoder[-1])
    lse_size = layout.sizes[1]
    narrow = layout.biases + layout.encoder_layers + layout.decoder_layers
    lse = pack.narrow_down(xs, layout.encoder(layout.encoder_layers), lse_size) + pack.narrow(narrow, 0, lse_size)
    inverse = jax.lax.rsqrt(jnp.sum(lse * lse, axis=1, keepdims=True) + SPHERE_EPSILON)
    lse = lse * inverse if layout.on_sphere else lse
    start = layout.decoder(0)
    zs = add(pack.widen([lse], start), pack.widen([code], start + lse_size))
    for layer in range(layout.decoder_layers):
        zs = pack.widen(relu(decoder[-1]), layout.decoder(layer)) if layer else zs
        decoder.append(add(zs, pack.vector(layout.biases + layout.encoder_layers + layer)))
    return _Pass(encoder, inverse, lse, decoder)


def _head_kernel(layout: PolicyLayout, x: Any, code: Any, pack_ref: Any, head: Any) -> None:
    pack = Pack(pack_ref, layout.width, layout.bfloat16)
    done = _forward(layout, x[...], code[...], pack)
    outputs = layout.sizes[3]
    bias = pack.narrow(layout.biases + layout.encoder_layers + layout.decoder_layers, layout.sizes[1], outputs)
    head[...] = pack.narrow_down(relu(done.decoder[-1]), layout.decoder(layout.decoder_layers), outputs) + bias


def _gradient_kernel(layout: PolicyLayout, x: Any, code: Any, dhead: Any, pack_ref: Any, *results: Any) -> None:
    """Writes gradients by code and LSE, the LSE, each layer's gradient and output, and sums for the biases."""
    pack = Pack(pack_ref, layout.width, layout.bfloat16)
    done = _forward(layout, x[...], code[...], pack)
    by_code, by_lse, lse_out, *layers, sums = results
    lse_size, code_size = layout.sizes[1:3]
    depth = layout.encoder_layers + layout.decoder_layers
    lse_out[...] = done.lse.astype(lse_out.dtype)
    grads = pack.narrow_down_back(dhead[...], layout.decoder(layout.decoder_layers))
    for layer in reversed(range(layout.decoder_layers)):
        grads = masked(grads, done.decoder[layer])
        index = layout.encoder_layers + layer
        write(layers[index], grads)
        write(layers[depth + index], relu(done.decoder[layer]))
        write_sums(sums, index, grads)
        if layer:
            grads = pack.widen_back(grads, layout.decoder(layer), layout.width)
    start = layout.decoder(0)
    by_code[...] = pack.widen_back(grads, start + lse_size, code_size)[0]
    grad = pack.widen_back(grads, start, lse_size)[0]
    if layout.on_sphere:
        grad = done.inverse * (grad - done.lse * jnp.sum(grad * done.lse, axis=1, keepdims=True))
    by_lse[...] = grad
    grads = pack.narrow_down_back(grad, layout.encoder(layout.encoder_layers))
    for layer in reversed(range(layout.encoder_layers)):
        grads = masked(grads, done.encoder[layer])
        write(layers[layer], grads)
        write(layers[depth + layer], relu(done.encoder[layer]))
        write_sums(sums, layer, grads)
        if layer:
            grads = pack.widen_back(grads, layout.encoder(layer), layout.width)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def heads(layout: PolicyLayout, pack: jax.Array, x: jax.Array, code: jax.Array) -> jax.Array:
    """Returns the decoder's outputs [n, padded] of observations and codes [n, padded].

    Observations get no gradient: nothing that learns is behind them.
    """
    kernel, result = partial(_head_kernel, layout), (layout.sizes[3], jnp.float32)
    return launch(kernel, "policy_forward", FORWARD_ROWS, [x, code], pack, [result])[0]


def _heads_fwd(layout: PolicyLayout, pack: jax.Array, x: jax.Array, code: jax.Array) -> Any:
    return heads(layout, pack, x, code), (pack, x, code)


def _heads_bwd(layout: PolicyLayout, saved: Any, grad: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    pack, x, code = saved
    dtype = jnp.bfloat16 if layout.bfloat16 else jnp.float32
    depth = layout.encoder_layers + layout.decoder_layers
    lse_size, code_size = layout.sizes[1:3]
    kept = [(code_size, jnp.float32), (lse_size, jnp.float32), (lse_size, dtype), *[(layout.width, dtype)] * 2 * depth]
    for last in (layout.encoder_layers, depth):  # inputs of the layers that multiply float32
        kept[2 + depth + last] = (layout.width, jnp.float32)
    kernel = partial(_gradient_kernel, layout)
    found = launch(kernel, "policy_gradient", BACKWARD_ROWS, [x, code, grad], pack, kept, depth)
    by_code, by_lse, lse, *layers, sums = found
    inputs = jnp.concatenate([lse, code.astype(dtype)], axis=1)
    rows = list(_weight_gradients(layout, x.astype(dtype), by_lse, inputs, grad, layers))
    narrow = layout._narrow_row(jnp.sum(by_lse, axis=0), jnp.sum(grad, axis=0))
    return jnp.concatenate([*rows, jnp.sum(sums, axis=0), narrow[None]]), jnp.zeros_like(x), by_code


def _weight_gradients(
    layout: PolicyLayout, x: jax.Array, by_lse: jax.Array, inputs: jax.Array, grad: jax.Array, layers: list[jax.Array]
) -> Iterator[jax.Array]:
    """Yields the gradient by each weight matrix, in the order of the pack."""
    depth, split = len(layers) // 2, layout.encoder_layers
    grads, hidden = layers[:depth], layers[depth:]
    yield weight_gradient(x, grads[0])
    for layer in range(1, split):
        yield weight_gradient(hidden[layer - 1], grads[layer])
    yield weight_gradient(by_lse, hidden[split - 1])
    yield weight_gradient(inputs, grads[split])
    for layer in range(split + 1, depth):
        yield weight_gradient(hidden[layer - 1], grads[layer])
    yield weight_gradient(grad, hidden[depth - 1])


heads.defvjp(_heads_fwd, _heads_bwd)


def head_of_item(layout: PolicyLayout) -> Any:
    """Returns a function (pack, obs, code) → decoder output of one item, which `vmap` makes one launch."""
    obs_size, code_size = layout.sizes[0], layout.sizes[2]

    def of_batch(pack: jax.Array, obs: jax.Array, code: jax.Array) -> jax.Array:
        obs = jnp.pad(obs, ((0, 0), (0, obs_size - layout.obs)))
        code = jnp.pad(code, ((0, 0), (0, code_size - layout.code)))
        return heads(layout, pack, obs, code)[:, : layout.outputs]

    @jax.custom_batching.custom_vmap
    def of_item(pack: jax.Array, obs: jax.Array, code: jax.Array) -> jax.Array:
        return of_batch(pack, *(jnp.tile(x[None], (FORWARD_ROWS, 1)) for x in (obs, code)))[0]

    @of_item.def_vmap
    def _(size: int, batched: list[bool], pack: jax.Array, obs: jax.Array, code: jax.Array) -> tuple[jax.Array, bool]:
        assert batched == [False, True, True], "a policy is applied to a batch at once"
        return of_batch(pack, obs, code), True

    return of_item
