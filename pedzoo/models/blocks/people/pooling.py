"""Social GAN's pooling module (Gupta et al., CVPR 2018, eq. 2), exact and without its n x n x 512 tensor.

For person i, every j of the same scene (i too) gives an embedded relative position beside its hidden state:

    pool_i = max_j ReLU(W_2 ReLU(W_1 [W_e (p_j - p_i) + b_e; h_j] + b_1) + b_2).

People beyond `pedzoo.models.blocks.people.crowd.REACH` are left out.

No activation stands between W_e and W_1, so the inner vector is u_j - v_i with one u and one v per person.
Then ReLU(u_j - v_i) = max(u_j, v_i) - v_i, which leaves one maximum and one product with W_2 per pair.
Backwards, only the winning pair of each person and channel has a gradient.
"""

from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from pedzoo.models.blocks.mlp import mlp
from pedzoo.models.blocks.people.crowd import Crowd, share_seen

_CPU_FLOATS = 2**20
"""Size of the buffer of pairs on a CPU: 4 MB of float32, near enough to the cache (measured)."""

_GPU_FLOATS = 2**26
"""The same on an accelerator, where only memory limits it."""

_AT_ONCE = 2**17
"""Numbers in the pairs of scenes so small that only the number of calls counts."""


class SocialPooling(nn.Module):
    """Max-pools features of all people in the scene for each person."""

    def __init__(
        self, hidden_dim: int, embedding_dim: int = 16, mlp_dim: int = 512, bottleneck_dim: int = 8
    ) -> None:
        """Create the parameters; widths are of hidden states, embedded positions, the layer, the result."""
        super().__init__()
        self.embedding = nn.Linear(2, embedding_dim)
        self.mlp = mlp(embedding_dim + hidden_dim, mlp_dim, bottleneck_dim)

    def forward(self, hidden: Tensor, position: Tensor, crowd: Crowd) -> Tensor:
        """Return pooled vectors (P, bottleneck_dim) of hidden states (P, H) at positions (P, 2), metres."""
        inner, outer = cast("nn.Linear", self.mlp[0]), cast("nn.Linear", self.mlp[2])
        w_2, b_2 = outer.weight, outer.bias
        # W_e and b_e are put into W_1 and b_1
        w_e, b_e, w_1 = self.embedding.weight, self.embedding.bias, inner.weight
        w_1e, w_1h = w_1[:, : len(w_e)], w_1[:, len(w_e) :]
        w_v = w_1e @ w_e
        w_u, b_u = torch.cat((w_v, w_1h), 1), torch.addmv(inner.bias, w_1e, b_e)
        # Differences of large coordinates lose digits: positions count from the first person of the scene.
        origin = position[:1] if crowd.shape[0] == 1 else position[crowd.first]
        away = position - origin
        u = functional.linear(torch.cat((away, hidden), 1), w_u, b_u)
        v = functional.linear(away, w_v)
        if crowd.absent is not None:
            best = _max_at_once(u, v, w_2, away.view(*crowd.shape, 2), crowd.absent)
        elif torch.is_grad_enabled():
            return torch.relu(_MaxOverPairs.apply(u, v, w_2, crowd, away) + b_2)
        elif crowd.full and u.numel() * crowd.shape[1] <= _AT_ONCE:
            best = _max_at_once(u, v, w_2, away.view(*crowd.shape, 2))
        else:
            best = _max_over_pairs(u, v, w_2, crowd.groups, away)[0]
        return functional.linear(v, -w_2, b_2).add_(best).relu_()


class _MaxOverPairs(torch.autograd.Function):
    """max_j W ReLU(u_j - v_i) with a gradient that visits the winning pairs only."""

    @staticmethod
    def forward(ctx: Any, u: Tensor, v: Tensor, weight: Tensor, crowd: Crowd, place: Tensor) -> Tensor:
        """Return the maxima (P, C) of a crowd at places (P, 2), metres."""
        best, winner = _max_over_pairs(u, v, weight, crowd.groups, place)
        ctx.save_for_backward(u, v, weight, winner.add_(crowd.first.unsqueeze(1)))
        return best - v @ weight.t()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of ``u``, ``v`` and ``weight`` from that of the maxima (P, C)."""
        u, v, weight, winner = ctx.saved_tensors
        to_people = ctx.needs_input_grad[0] or ctx.needs_input_grad[1]
        channels, width = weight.shape
        grad_u, grad_v, grad_w = torch.zeros_like(u), torch.empty_like(v), torch.zeros_like(weight)
        rows = max(1, _buffer_size(u) // (2 * channels * width))
        buffer = u.new_empty(2, min(rows, len(u)), channels, width)
        for start in range(0, len(u), rows):
            part = slice(start, start + rows)
            winners, g = winner[part].flatten(), grads[0][part]
            inner, back = buffer[:, : len(g)]
            torch.index_select(u, 0, winners, out=inner.view(-1, width))
            inner.sub_(v[part].unsqueeze(1)).clamp_(min=0)
            if ctx.needs_input_grad[2]:
                grad_w += torch.bmm(g.t().unsqueeze(1), inner.transpose(0, 1)).squeeze(1)
            if to_people:
                torch.mul(g.unsqueeze(2), weight, out=back)
                torch.ops.aten.threshold_backward.grad_input(back, inner, 0, grad_input=back)
                grad_u.index_add_(0, winners, back.view(-1, width))
                torch.sum(back, 1, out=grad_v[part])
        return grad_u, grad_v.neg_(), grad_w, None, None


def _max_over_pairs(
    u: Tensor, v: Tensor, weight: Tensor, groups: tuple[Tensor, ...], place: Tensor
) -> tuple[Tensor, Tensor]:
    """Return max_j W max(u_j, v_i) over the scene of i (P, C), and which of its people won (P, C) long.

    ``groups`` are the people (G, n) of the scenes of each size n; u and v are (P, D), and W is (C, D). People
    are at places (P, 2), metres; those beyond reach take no part.
    """
    if not groups:
        return v.new_zeros(0, len(weight)), torch.zeros(0, len(weight), dtype=torch.long, device=v.device)
    width, pairs = u.shape[1], max(1, _buffer_size(u) // u.shape[1])
    room = (min(max(pairs, group.shape[1]), group.numel() * group.shape[1]) for group in groups)
    buffer = u.new_empty(max(room), width)
    result = []
    for group in groups:
        n = group.shape[1]
        # so many scenes, and so many rows of them, fit in the buffer
        scenes, rows = min(len(group), max(1, pairs // (n * n))), min(n, max(1, pairs // n))
        # A single group is all people, in order.
        seen, looking, at = (
            x.view(-1, n, x.shape[1]) if len(groups) == 1 else x[group] for x in (u, v, place)
        )
        for i in range(0, len(group), scenes):
            for k in range(0, n, rows):
                some = looking[i : i + scenes, k : k + rows].unsqueeze(2)
                shape = (*some.shape[:2], n)
                cells = buffer[: shape[0] * shape[1] * n]
                torch.maximum(seen[i : i + scenes].unsqueeze(1), some, out=cells.view(*shape, width))
                # With the few channels first this product is four times as fast: (C, G', rows, n).
                value = (weight @ cells.t()).view(-1, *shape)
                value -= _loss_of_far(at[i : i + scenes, k : k + rows], at[i : i + scenes])
                best, winner = value.max(3)
                result.append((best.flatten(1), winner.flatten(1)))
    best, winner = result[0] if len(result) == 1 else (torch.cat(x, 1) for x in zip(*result, strict=True))
    best, winner = best.t(), winner.t()
    if len(groups) > 1:
        back = torch.argsort(torch.cat([group.flatten() for group in groups]))
        best, winner = best[back], winner[back]
    return best, winner


def _loss_of_far(here: Tensor, there: Tensor) -> Tensor:
    """Return what is taken off people ``there`` (G, n, 2) as those ``here`` (G, m, 2) see them (G, m, n)."""
    return 1 / share_seen(there.unsqueeze(1) - here.unsqueeze(2)) - 1


def _max_at_once(u: Tensor, v: Tensor, weight: Tensor, place: Tensor, absent: Tensor | None = None) -> Tensor:
    """Return the maxima of `_max_over_pairs` in as few calls as possible.

    ``place`` is (B, A, 2); agents that are ``absent`` (B, A) take no part.
    """
    scenes, n = place.shape[:2]
    pairs = torch.maximum(u.view(scenes, 1, n, u.shape[1]), v.view(scenes, n, 1, u.shape[1]))
    value = functional.linear(weight, pairs.view(-1, u.shape[1])).view(-1, scenes, n, n)
    value = value - _loss_of_far(place, place)
    if absent is not None:
        value = value.masked_fill(absent.unsqueeze(1), -torch.inf)
    return value.amax(3).flatten(1).t()


def _buffer_size(like: Tensor) -> int:
    """Return how many numbers of the pairs are held at once on the device of ``like``."""
    return _CPU_FLOATS if like.device.type == "cpu" else _GPU_FLOATS
