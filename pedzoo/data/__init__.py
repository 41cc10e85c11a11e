"""From recorded tracks to scene batches: files, windows, goals, augmentation, the LightningDataModule."""
