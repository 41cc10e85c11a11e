"""Recurrent encoder and decoder of displacements (Gupta et al., CVPR 2018, eq. 1, 2 and 4).

Both compute exactly what the paper's step-by-step networks do, in one LSTM call: linear embeddings and the
decoder's linear feedback disappear in the LSTM's weights.
"""

from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

_CPU_CELLS = 2**19
"""People x steps x width per LSTM call on a CPU. Beyond, its buffers pass 32 MB: 1.7 times slower."""


class DisplacementEncoder(nn.Module):
    """Summarises a person's displacements: e = W_e d + b_e, h_t = LSTM(h_{t-1}, e_t) (eq. 1).

    As published, a zero goes before the first displacement. The state after it is the same for all people.
    """

    def __init__(self, embedding_dim: int, hidden_dim: int) -> None:
        """Create the parameters: widths of the embedding e and of the LSTM's state."""
        super().__init__()
        self.embedding = nn.Linear(2, embedding_dim)
        self.lstm = nn.LSTM(embedding_dim, hidden_dim)

    def forward(self, displacements: Tensor) -> Tensor:
        """Return the last hidden state (P, hidden_dim) after displacements (P, T, 2), metres per step."""
        return self.states(displacements)[0][0]

    def states(
        self, displacements: Tensor, start: tuple[Tensor, Tensor] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return hidden and cell state (1, P, H) after displacements (P, T, 2); ``start`` is zero if None."""
        weights = _folded(self.lstm, self.embedding)
        people, steps = displacements.shape[:2]
        width = self.lstm.hidden_size
        if start is None:  # the state after the zero displacement
            start = _from_rest(_without_forget(weights[2] + weights[3]))
        hidden, cell = (state.expand(1, people, width) for state in start)
        rows = _rows(steps * width, displacements)
        if people <= rows:
            return _lstm(displacements, (hidden, cell), weights, batch_first=True)[1:]
        pieces = zip(displacements.split(rows), hidden.split(rows, 1), cell.split(rows, 1), strict=True)
        ends = [_lstm(moved, (h, c), weights, batch_first=True)[1:] for moved, h, c in pieces]
        hidden, cell = (torch.cat(end, 1) for end in zip(*ends, strict=True))
        return hidden, cell


class DisplacementDecoder(nn.Module):
    """Continues displacements: h_t = LSTM(h_{t-1}, W_e d_{t-1} + b_e), d_t = W_p h_t + b_p (eq. 4).

    With W_e, b_e, W_p and b_p put into the LSTM, its gates at step t are

        (W_hh + W_ih W_e W_p) h_{t-1} + W_ih W_e x_t + b_ih + b_hh + W_ih (b_e + W_e b_p),

    where x_t = 0, but for the first step, whose input is the observed displacement and not W_p h_0 + b_p.
    """

    def __init__(self, embedding_dim: int, hidden_dim: int) -> None:
        """Create the parameters: widths of embedded displacements and of the LSTM's state."""
        super().__init__()
        self.embedding = nn.Linear(2, embedding_dim)
        self.lstm = nn.LSTM(embedding_dim, hidden_dim)
        self.output = nn.Linear(hidden_dim, 2)

    def forward(self, hidden: Tensor, first: Tensor, steps: int) -> Tensor:
        """Return the next displacements (P, steps, 2), metres per step, after ``first`` (P, 2).

        The cell state starts at zero.
        """
        w_in, w_hh, b_ih, b_hh = _folded(self.lstm, self.embedding)
        w_out, b_out = self.output.weight, self.output.bias
        if steps == 1:
            weight, bias = _without_forget(torch.cat((w_in, w_hh), 1)), _without_forget(b_ih + b_hh)
            gates = functional.linear(torch.cat((first, hidden), 1), weight, bias)
            return functional.linear(_from_rest(gates)[0], w_out, b_out).unsqueeze(1)
        # the output is fed back
        weights = [w_in, torch.addmm(w_hh, w_in, w_out), b_ih, torch.addmv(b_hh, w_in, b_out)]
        rows = _rows(steps * hidden.shape[1], hidden)
        whole = len(hidden) <= rows
        pieces = [(hidden, first)] if whole else zip(hidden.split(rows), first.split(rows), strict=True)
        parts = []
        for h0, d0 in pieces:
            surprise = (d0 - functional.linear(h0, w_out, b_out)).unsqueeze(0)
            inputs = functional.pad(surprise, (0, 0, 0, 0, 0, steps - 1))
            state = (h0.unsqueeze(0), torch.zeros_like(h0).unsqueeze(0))
            parts.append(functional.linear(_lstm(inputs, state, weights)[0], w_out, b_out))
        return (parts[0] if len(parts) == 1 else torch.cat(parts, 1)).transpose(0, 1)


def _folded(lstm: nn.LSTM, embedding: nn.Linear) -> list[Tensor]:
    """Return weights (4H, 2), (4H, H) and biases (4H,), (4H,) of ``lstm`` after ``embedding``."""
    w_ih, w_hh, b_ih, b_hh = cast(
        "list[Tensor]", [lstm.weight_ih_l0, lstm.weight_hh_l0, lstm.bias_ih_l0, lstm.bias_hh_l0]
    )
    return [w_ih @ embedding.weight, w_hh, torch.addmv(b_ih, w_ih, embedding.bias), b_hh]


def _without_forget(gates: Tensor) -> Tensor:
    """Return the rows (3H, ...) of input, output and cell gate of torch's (4H, ...)."""
    i, _, g, o = gates.chunk(4)
    return torch.cat((i, o, g))


def _from_rest(gates: Tensor) -> tuple[Tensor, Tensor]:
    """Return hidden and cell state (..., H) of an LSTM's first step, from its gates (..., 3H)."""
    i, o, g = gates.chunk(3, -1)
    cell = i.sigmoid() * g.tanh()
    return o.sigmoid() * cell.tanh(), cell


def _rows(cells: int, people: Tensor) -> int:
    """Return for how many of ``people`` (P, ...) an LSTM runs at once, given its steps x width."""
    if people.device.type != "cpu" or torch.compiler.is_exporting():
        return max(1, len(people))
    return max(1, _CPU_CELLS // cells)


def _lstm(
    inputs: Tensor, state: tuple[Tensor, Tensor], weights: list[Tensor], batch_first: bool = False
) -> tuple[Tensor, Tensor, Tensor]:
    """Return all hidden states (T, P, H) of an LSTM, and the last hidden and cell state (1, P, H)."""
    # has biases, layers, dropout, training, bidirectional, batch first
    options = True, 1, 0.0, torch.is_grad_enabled(), False, batch_first
    if not inputs.is_cuda:
        return torch.lstm(inputs, state, weights, *options)
    # cuDNN warns about weights that are no slices of one buffer, which folded ones never are.
    with torch.backends.cudnn.flags(enabled=False):
        return torch.lstm(inputs, state, weights, *options)
