"""Numbers of steps between outputs."""

from math import gcd

import pytest

from crosscheck.compare.ladder import counts, finer


@pytest.mark.parametrize("n", [*range(1, 200), 1000, 4096])
@pytest.mark.parametrize("fine", [False, True])
def test_no_two_share_a_divisor(n, fine):
    one, two, three = counts(n, finer=fine)
    assert one > two > three >= 1
    assert gcd(one, two) == gcd(two, three) == gcd(one, three) == 1
    assert n in (one, three)
    assert gcd(finer(one), one) == 1


@pytest.mark.parametrize("n", range(12, 300, 7))
def test_coarser_ones_are_near_a_half_and_a_quarter(n):
    one, two, three = counts(n)
    assert one == n
    assert abs(two - n / 2) <= 4
    assert abs(three - n / 4) <= 4


def test_few_steps_are_refined():
    assert counts(1) == (5, 3, 1)
    assert counts(5) == (21, 11, 5)


@pytest.mark.parametrize(("n", "multiple"), [(8, 4), (30, 5), (4, 4), (60, 3)])
def test_a_sampled_servo_forces_multiples(n, multiple):
    found = counts(n, multiple)
    assert all(each % multiple == 0 for each in found)
    assert n in found
    assert finer(found[0], multiple) % multiple == 0
