"""A class that takes a name of the framework is refused when it is made, with the names."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.core.agent import Agent, Identity
from armadico.core.discovery import Found
from armadico.mobile.behaviour import Behaviour
from armadico.mobile.messages import Pose
from armadico.mobile.obstacles import Obstacles


def test_methods_and_attributes_of_the_framework_are_refused_together() -> None:
    with pytest.raises(TypeError) as refused:

        class Weaver(Behaviour):
            name = "weaver"
            memory = 3

            def log(self) -> None: ...  # type: ignore[override]

            @property
            def cycles(self) -> int:  # type: ignore[override]
                return 0

            def on_start(self) -> None:
                self.query = []  # type: ignore[method-assign, assignment]
                self.seen, self.route = 1, None  # type: ignore[assignment]

                def later() -> None:
                    self._speeds = 7  # type: ignore[assignment]

                self.later = later

    text = str(refused.value)
    found = text.partition("Choose")[0]
    for name in ("memory", "log (line ", "cycles (line", "self.query", "self.route", "_speeds"):
        assert name in found
    for free in ("seen", "later", "on_start", "name,"):
        assert free not in found
    assert "publish" in text, "it lists what is taken"


def test_a_name_in_a_mix_in_is_refused() -> None:
    class Mixed:
        def wake_at(self) -> None: ...

    with pytest.raises(TypeError, match=r"wake_at \(line"):
        type("Sleeper", (Mixed, Agent), {"name": "sleeper"})


def test_what_the_kernel_does_has_no_name_in_an_agent() -> None:
    class Free(Agent):
        name = "free"

        def on_start(self) -> None:
            self.history = self.card = self.outbox = self.bids = 1

        def stop(self) -> None:
            raise AssertionError

        start = receive = wake = wakeup = leave = stop

    kernel = Free(Identity("free-1")).kernel
    kernel.start(0.0)
    kernel.wake(1.0)
    kernel.leave(2.0)
    assert (kernel.card().name, kernel.history().bids) == ("free", ())


def test_hooks_declarations_handlers_and_names_overridden_on_purpose_are_accepted() -> None:
    class Mine(Behaviour, overrides=("limited",)):
        name = "mine"
        needs_goal = False

        def propose(self, pose: Pose, obstacles: Obstacles) -> None:
            self.why, self.lacks, self.own = "", "", pose

        def on_parameters(self, before: object) -> None: ...

        def limited(self, *wanted):  # type: ignore[no-untyped-def, override]
            return super().limited(*wanted)

    class Derived(Mine):  # what was overridden on purpose is no fault of a subclass
        name = "derived"

    Derived(Identity("derived-1")).kernel.start(0.0)


def test_a_base_class_for_agents_protects_its_own_names() -> None:
    class Base(Agent, hooks=("judge",)):
        def __init__(self, identity: Identity) -> None:
            super().__init__(identity)
            self.verdicts = 0

        def judge(self) -> None: ...

        def count(self) -> None: ...

    class Good(Base):
        name = "good"

        def judge(self) -> None: ...

    with pytest.raises(TypeError, match=r"count \(line \d+\), self\.verdicts \(line"):

        class Bad(Base):
            def count(self) -> None: ...

            def on_start(self) -> None:
                self.verdicts = 1


def test_an_installed_class_is_refused_with_its_own_file_and_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = "from armadico import Agent\n\n\nclass Bad(Agent):\n    name = 'bad'\n    query = 1\n"
    (tmp_path / "bad_names.py").write_text(lines)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ImportError, match=r"names of the framework: query.*bad_names.py, line 4"):
        Found("bad", "bad_names:Bad", "bad").load()
