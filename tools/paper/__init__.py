"""The paper's tables and its Figure 4, made again beside the paper's own numbers."""
