"""Campaigns: a navigation loop flown over and over, with other seeds, beliefs, faults, budgets and estimators."""
