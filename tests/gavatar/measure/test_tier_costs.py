"""Which tiers pay, by what was measured of them."""

from __future__ import annotations

from gavatar.measure.tier_costs import on_front


def test_tiers_that_pay_are_chosen_beyond_the_noise_of_times():
    def front(**tiers) -> list[str]:
        return [
            t["name"]
            for t in on_front(
                [{"name": n, "frame_ms": ms, "psnr_capture": c, "psnr_mixed": m} for n, (ms, c, m) in tiers.items()]
            )
        ]

    assert front(full=(400, 100, 100), a=(9, 40, 40), b=(10, 39, 39)) == ["full", "a"]
    assert front(full=(400, 100, 100), b=(9, 39, 39), a=(9.5, 40, 40)) == ["full", "a"]  # 9 against 9.5 ms is noise
    assert front(full=(400, 100, 100), a=(9, 40, 38), b=(50, 40, 40)) == ["full", "a", "b"]  # closer on mixed poses
    assert front(full=(400, 100, 100), a=(9, 40, 39.6), b=(50, 40.1, 40)) == ["full", "a"]  # not by enough to pay
    assert front(full=(13.1, 100, 100), int8=(13.0, 62, 62)) == ["full"]
    assert front(full=(13, 100, 100), int8=(9, 62, 62)) == ["full", "int8"]
    assert front(a=(9, 40, 40), b=(9, 40, 40)) == ["a"]  # one of two that are alike
    assert front(full=(10, 100, 100), a=(20, 100, 100)) == ["full"]
