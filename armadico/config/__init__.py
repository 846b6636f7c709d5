"""Configuration: TOML files as frozen structs, worlds, scenarios, hosts."""
