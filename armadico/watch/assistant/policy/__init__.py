"""What programs and language models may do: policies, approvals, and the log of requests."""
