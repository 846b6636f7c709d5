"""The server of the Model Context Protocol: a society for programs and language models."""
