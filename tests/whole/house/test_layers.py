"""What `make lint`'s contracts (pyproject.toml, import-linter) cannot say of imports."""

from __future__ import annotations

from tests.whole.house.tree import imports, modules, project, within


def agents() -> set[str]:
    """The modules with an agent, by the entry points."""
    points = project()["project"]["entry-points"]["armadico.agents"].values()
    return {point.partition(":")[0] for point in points}


def test_agents_never_import_each_other() -> None:
    assert len(agents()) >= 7
    # A rival mechanism may be a variant of another one: trust is an auction.
    mine = {name for name in agents() if not within(name, "armadico.agents.rivals")}
    assert not [f"{name} imports {i}" for name in mine for i in imports(name) & agents()]


def test_every_module_is_in_a_layer() -> None:
    contracts = project()["tool"]["importlinter"]["contracts"]
    layers = " ".join(contracts[0]["layers"]).translate(str.maketrans("|:()", "    ")).split()
    doors = {f"armadico.{name}" for name in ("__main__", "child", "agents", "bridge", "configs")}
    loose = {name for name in modules() if not any(within(name, layer) for layer in layers)}
    assert loose == {"armadico", *doors}
