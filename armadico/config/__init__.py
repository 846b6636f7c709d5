"""Configuration: TOML into frozen structs, worlds, scenarios, hosts. Errors name file and line."""
