import itertools

import numpy as np
import pytest

from brdfatlas.measures.recommendation import MAX_ALBEDO, SAME_DE00, Candidate, choose

ROWS = [
    Candidate("tabulated", 0.5, 1440, 0.2, max_albedo=0.9),
    Candidate("gltf", 2.0, 20, 1.0, max_albedo=0.9, targets=("gltf", "materialx")),
    Candidate("principled", 1.5, 48, 2.0, max_albedo=1.2, targets=("mitsuba",)),
    Candidate("low_rank_4", 0.1, 7000, 9.0, max_albedo=0.9, status="ours: weighted factors"),
    Candidate("lawrence", 0.3, 9000, 9.0, max_albedo=0.95, status="reconstruction: of the factors", reciprocal=False),
    Candidate("broken", float("nan"), 4, max_albedo=0.5, targets=("gltf",)),
]


@pytest.mark.parametrize(
    ("conditions", "expected"),
    [
        ({}, "low_rank_4"),
        ({"budget": 6999}, "tabulated"),
        ({"budget": 1440}, "tabulated"),
        ({"budget": 64}, "principled"),
        ({"budget": 64, "energy": True}, "gltf"),
        ({"budget": 19}, None),
        ({"target": "gltf"}, "gltf"),
        ({"target": "mitsuba", "energy": True}, None),
        ({"published": True}, "lawrence"),
        ({"published": True, "reciprocal": True}, "tabulated"),
        ({"target": "nowhere"}, None),
    ],
)
def test_the_best_that_meets_all_conditions(conditions, expected):
    chosen = choose(ROWS, **conditions)
    assert (chosen.model if chosen else None) == expected


def test_differences_that_no_eye_sees_are_decided_by_bytes_then_name():
    """Not by seconds, which two runs measure differently."""
    for times in itertools.permutations((1.0, 2.0, float("nan"))):
        near = [
            Candidate("a", 1.0, 100, 0.1),
            *(Candidate(name, 1.0 + 0.9 * SAME_DE00, 50, seconds) for name, seconds in zip("bcd", times, strict=True)),
            Candidate("e", 1.0 + 1.5 * SAME_DE00, 10, 0.1),
        ]
        for rows in itertools.permutations(near):
            assert choose(rows).model == "b"


def test_failed_fits_and_unknown_albedos_are_never_taken_for_good_ones():
    failed = Candidate("failed", float("nan"), 1)
    unknown = Candidate("unknown", 1.0, 1)
    assert choose([failed]) is None
    assert choose([failed, unknown]) is unknown
    assert choose([unknown], energy=True) is None
    assert choose([]) is None


def test_a_condition_more_never_finds_a_better_picture():
    rng = np.random.default_rng(0)
    for _ in range(200):
        rows = [
            Candidate(
                str(i),
                float(rng.exponential()),
                int(rng.integers(1, 100)),
                reciprocal=bool(rng.integers(2)),
                max_albedo=float(rng.uniform(0.5, 1.5) * MAX_ALBEDO),
                status=str(rng.choice(["", "ours: x"])),
                targets=tuple(rng.choice(["gltf", "mitsuba"], 1)),
            )
            for i in range(8)
        ]
        every = {"budget": 50, "target": "gltf", "reciprocal": True, "published": True, "energy": True}
        free = choose(rows)
        for key, value in every.items():
            bound = choose(rows, **{key: value})
            assert bound is None or bound.de00 >= free.de00 - SAME_DE00
