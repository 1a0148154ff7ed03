"""The planner decides what is drawn, by which engine, and the error to expect: functions of views and tolerance."""
