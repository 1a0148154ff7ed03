"""The planner chooses the engine of each region and predicts its error: functions of views and tolerance."""
