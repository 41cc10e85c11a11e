"""Tables of models and policies: forecasts, rollouts, suites of cases, intervals, pages."""
