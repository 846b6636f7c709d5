"""What looks at a society from outside, and keeps, measures or draws what it sees."""
