"""Memory that tensors give back stays with the process."""

from __future__ import annotations

import torch


def keep_freed_memory() -> None:
    """Let the C library keep up to 62 MB of freed memory instead of returning it to the system.

    A step of a thousand scenes makes and drops hundreds of tensors of about a megabyte. glibc returns such
    memory at once, and each new 4 kB page costs a fault: half of ORCA's time at 1024 x 5. glibc adapts its
    thresholds to the size of what was mapped and freed, up to 32 MB (mallopt(3), M_MMAP_THRESHOLD).
    """
    torch.empty(31 << 20, dtype=torch.uint8)  # elsewhere this does nothing
