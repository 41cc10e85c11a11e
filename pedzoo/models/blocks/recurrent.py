"""Recurrent encoder and decoder of displacements (Gupta et al., CVPR 2018, eq. 1, 2 and 4).

Both compute exactly what the paper's step-by-step networks do, in one LSTM call. A linear embedding has no
activation, so it disappears in the LSTM's input weights; so does the decoder's feedback, which is linear too.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

_CPU_CELLS = 2**19
"""People x steps x width per LSTM call on a CPU. Beyond, its buffers pass 32 MB, which the C library takes
from the system page by page at every call: 1.7 times slower (measured)."""


class DisplacementEncoder(nn.Module):
    """Summarises a person's displacements: e = W_e d + b_e, h_t = LSTM(h_{t-1}, e_t) (eq. 1)."""

    def __init__(self, embedding_dim: int, hidden_dim: int) -> None:
        """Create the parameters.

        Args:
            embedding_dim: Width of the embedding e.
            hidden_dim: Width of the LSTM's state.
        """
        super().__init__()
        self.embedding = nn.Linear(2, embedding_dim)
        self.lstm = nn.LSTM(embedding_dim, hidden_dim)

    def forward(self, displacements: Tensor) -> Tensor:
        """Return the last hidden state (P, hidden_dim) of ``displacements`` (P, T, 2), metres per step."""
        return self.states(displacements)[0][0]

    def states(
        self, displacements: Tensor, start: tuple[Tensor, Tensor] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return hidden and cell state (1, P, hidden_dim) after ``displacements``, from ``start`` or zero."""
        weights, width = _folded(self.lstm, self.embedding), self.lstm.hidden_size
        if start is None:
            zero = displacements.new_zeros(1, displacements.shape[0], width)
            start = zero, zero
        rows = _rows(displacements.shape[1] * width, displacements)
        if len(displacements) <= rows:
            return _lstm(displacements, start, weights, batch_first=True)[1:]
        pieces = zip(displacements.split(rows), start[0].split(rows, 1), start[1].split(rows, 1), strict=True)
        ends = [_lstm(moved, (h, c), weights, batch_first=True)[1:] for moved, h, c in pieces]
        return torch.cat([end[0] for end in ends], 1), torch.cat([end[1] for end in ends], 1)


class DisplacementDecoder(nn.Module):
    """Continues displacements: h_t = LSTM(h_{t-1}, W_e d_{t-1} + b_e), d_t = W_p h_t + b_p (eq. 4).

    With W_e, b_e, W_p and b_p put into the LSTM, its gates at step t are

        (W_hh + W_ih W_e W_p) h_{t-1} + W_ih W_e x_t + b_ih + b_hh + W_ih (b_e + W_e b_p),

    where x_t = 0, but for the first step, whose input is the observed displacement and not W_p h_0 + b_p.
    """

    def __init__(self, embedding_dim: int, hidden_dim: int) -> None:
        """Create the parameters.

        Args:
            embedding_dim: Width of the embedding of the fed back displacement.
            hidden_dim: Width of the LSTM's state.
        """
        super().__init__()
        self.embedding = nn.Linear(2, embedding_dim)
        self.lstm = nn.LSTM(embedding_dim, hidden_dim)
        self.output = nn.Linear(hidden_dim, 2)

    def forward(self, hidden: Tensor, first: Tensor, steps: int) -> Tensor:
        """Return the next displacements (P, steps, 2), metres per step.

        Args:
            hidden: Initial hidden state (P, hidden_dim); the cell state starts at zero.
            first: Last observed displacement (P, 2).
            steps: How many displacements are wanted.
        """
        if steps == 1:
            # Folding would cost more than it saves.
            state = (hidden, torch.zeros_like(hidden))
            state = torch._VF.lstm_cell(self.embedding(first), state, *_weights(self.lstm))
            return self.output(state[0]).unsqueeze(1)
        w_in, w_hh, b_ih, b_hh = _folded(self.lstm, self.embedding)
        w_hh = torch.addmm(w_hh, w_in, self.output.weight)
        b_hh = torch.addmv(b_hh, w_in, self.output.bias)
        weights = [w_in, w_hh, b_ih, b_hh]

        rows = _rows(steps * self.lstm.hidden_size, hidden)
        parts = []
        for h0, d0 in zip(hidden.split(rows), first.split(rows), strict=True):
            surprise = (d0 - self.output(h0)).unsqueeze(0)
            inputs = functional.pad(surprise, (0, 0, 0, 0, 0, steps - 1))
            state = (h0.unsqueeze(0), torch.zeros_like(h0).unsqueeze(0))
            parts.append(self.output(_lstm(inputs, state, weights)[0]))
        return (parts[0] if len(parts) == 1 else torch.cat(parts, 1)).transpose(0, 1)


def _weights(lstm: nn.LSTM) -> list[Tensor]:
    """Return the weights (4H, E), (4H, H) and biases (4H,), (4H,) of ``lstm``."""
    return cast("list[Tensor]", [lstm.weight_ih_l0, lstm.weight_hh_l0, lstm.bias_ih_l0, lstm.bias_hh_l0])


def _folded(lstm: nn.LSTM, embedding: nn.Linear) -> list[Tensor]:
    """Return weights (4H, 2), (4H, H) and biases (4H,), (4H,) of ``lstm`` after ``embedding``."""
    w_ih, w_hh, b_ih, b_hh = _weights(lstm)
    return [w_ih @ embedding.weight, w_hh, torch.addmv(b_ih, w_ih, embedding.bias), b_hh]


def _rows(cells: int, people: Tensor) -> int:
    """Return for how many of ``people`` (P, ...) an LSTM runs at once, given its steps x width."""
    return max(1, _CPU_CELLS // cells if people.device.type == "cpu" else len(people))


def _lstm(
    inputs: Tensor, state: tuple[Tensor, Tensor], weights: list[Tensor], batch_first: bool = False
) -> tuple[Tensor, Tensor, Tensor]:
    """Return all hidden states (T, P, H) of an LSTM, and the last hidden and cell state (1, P, H).

    Args:
        inputs: The LSTM's inputs (T, P, 2).
        state: First hidden and cell state (1, P, H).
        weights: What `_folded` returns.
        batch_first: Inputs and hidden states are (P, T, ...).
    """
    # cuDNN warns about weights that are no slices of one buffer, which folded ones never are.
    cudnn = torch.backends.cudnn.flags(enabled=False) if inputs.is_cuda else nullcontext()
    train = torch.is_grad_enabled()
    with cudnn:
        # has biases, layers, dropout, training, bidirectional, batch first
        return torch._VF.lstm(inputs, state, weights, True, 1, 0.0, train, False, batch_first)
