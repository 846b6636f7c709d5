"""A judgement has three answers, and unknown never passes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armadico.core.judgement import Answer, Judgement, all_of, no, unknown, whether, yes

judgements = st.lists(st.sampled_from([yes(), no("hit", "mend"), unknown("unseen", "look")]))


@given(judgements)
def test_only_yes_alone_passes(found: list[Judgement]) -> None:
    whole = all_of(found)
    assert whole.passed == (bool(found) and all(each.answer is Answer.YES for each in found))
    assert whole.passed == (whole.exit_code == 0)


@given(judgements)
def test_a_known_no_is_not_hidden_by_what_is_unknown(found: list[Judgement]) -> None:
    any_no = any(each.answer is Answer.NO for each in found)
    assert (all_of(found).answer is Answer.NO) == any_no


def test_reasons_are_those_of_the_answer() -> None:
    whole = all_of([yes("fine"), unknown("unseen", "look"), unknown("unheard"), unknown("unseen")])
    assert whole == unknown("unseen; unheard", "look")
    assert (whole.exit_code, str(whole)) == (3, "unknown: unseen; unheard")


def test_a_missing_measure_is_unknown() -> None:
    answers = [whether(value, "reason").answer for value in (True, False, None)]
    assert answers == [Answer.YES, Answer.NO, Answer.UNKNOWN]


def test_a_judgement_is_no_condition() -> None:
    with pytest.raises(TypeError, match="three answers"):
        _ = unknown("x") and True
