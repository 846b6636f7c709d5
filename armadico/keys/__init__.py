"""Keys: identities of a society's processes, and what each of them may do."""
