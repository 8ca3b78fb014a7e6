"""What a fit says that it is doing."""

from labkit.analysis.steps import Steps


def test_each_search_under_way_is_named_with_where_it_is() -> None:
    said: list[str] = []
    steps = Steps(lambda done, total, step: said.append(f"{done}/{total} {step}"))
    steps(0, 9, "searching from nothing: G at 3000 mm, G at 3300 mm")
    steps.heard("G at 3300 mm: start 4 of 40 at most")
    steps.heard("G at 3000 mm: defocus sweep")
    assert said[-1] == (
        "0/9 searching from nothing: G at 3000 mm (defocus sweep), G at 3300 mm (start 4 of 40 at most)"
    )
    steps(1, 9, "searching from nothing: G at 3300 mm")
    assert said[-1] == "1/9 searching from nothing: G at 3300 mm (start 4 of 40 at most)"
    steps(2, 9, "fitting: R at 3000 mm, R at 3300 mm and 2 more")
    assert said[-1] == "2/9 fitting: R at 3000 mm, R at 3300 mm and 2 more"


def test_what_comes_before_the_fits_says_no_number_of_steps_and_what_comes_after_counts_on() -> (
    None
):
    said: list[str] = []
    steps = Steps(lambda done, total, step: said.append(f"{done}/{total} {step}"))
    steps.before(1, 3, "finding the target")
    steps(18, 28, "what the fits make of the lens")
    run = steps.counted(lambda function, tasks: enumerate(map(function, tasks)))
    assert [result for _, result in run(abs, [-1, -2])] == [1, 2]
    assert said == [
        "0/0 finding the target, 1 of 3 done",
        "18/28 what the fits make of the lens",
        "19/28 what the fits make of the lens",
        "20/28 what the fits make of the lens",
    ]
