"""Metrics of forecasts and of walks: pure functions and torchmetrics classes.

Functions with ``@metric`` in files of this folder are metrics of crowds. `realism` compares with recorded
crowds and `robots` judges robots; each of these has a table of its own, to which a new measure is added.
"""
