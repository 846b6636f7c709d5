"""The methods agents use to reach their goals: pure functions and small classes, no messages."""
