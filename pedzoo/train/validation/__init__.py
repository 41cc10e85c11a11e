"""Closed-loop metrics beside ADE and FDE."""
