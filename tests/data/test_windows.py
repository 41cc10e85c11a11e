"""Sliding windows: by hand, by Social GAN's own loop and published counts; and batches of them."""

import tracemalloc
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch

from pedzoo.core.errors import UserError
from pedzoo.data.datamodule import BucketSampler, Draw
from pedzoo.data.datasets.eth_ucy import EthUcy
from pedzoo.data.recordings import Recording, Split
from pedzoo.data.scenes import KeptPeople, SceneSet, WindowCounts, Windows, cut_windows
from pedzoo.data.tracks import Tracks
from pedzoo.maps.bank import MapBank

FRAMES = (0, 10, 20, 30, 40, 100)  # six steps; the hole before the last is not looked at
SEEN = {1: (0, 1, 2, 3, 4, 5), 2: (0, 1, 2, 3), 3: (1, 2, 3, 4, 5), 4: (2,), 5: (1, 2, 4, 5)}


def recording(seen: dict[int, tuple[int, ...]], name: str = "hand") -> Tracks:
    rows = [(FRAMES[step], agent, agent, step) for agent, steps in seen.items() for step in steps]
    return Tracks.from_table(name, np.array(rows, dtype=float))


def listed(tracks: Tracks, windows: Windows) -> list[dict[int, list[int | None]]]:
    """Return the windows as {agent: steps, None where not seen}."""
    scenes = []
    for start, stop in zip(windows.offsets[:-1], windows.offsets[1:], strict=True):
        scene = {}
        for rows in windows.rows[start:stop]:
            (agent,) = {int(tracks.agent[row]) for row in rows if row >= 0}
            scene[agent] = [FRAMES.index(tracks.frame[row]) if row >= 0 else None for row in rows]
        scenes.append(scene)
    return scenes


ALONE = {agent: SEEN[agent] for agent in (1, 2)}


@pytest.mark.parametrize(
    ("seen", "steps", "options", "expected", "counts"),
    [
        # windows of 2 + 2 steps start at steps 0, 1 and 2; at their second step 4, 5 and 3 people are seen
        (
            SEEN,
            (2, 2),
            {},
            [
                {1: [0, 1, 2, 3], 2: [0, 1, 2, 3]},
                {1: [1, 2, 3, 4], 3: [1, 2, 3, 4]},
                {1: [2, 3, 4, 5], 3: [2, 3, 4, 5]},
            ],
            (3, 6, 0, 6),
        ),
        (ALONE, (2, 2), {}, [{1: [0, 1, 2, 3], 2: [0, 1, 2, 3]}], (1, 2, 2, 2)),
        (ALONE, (2, 2), {"min_people": 1}, None, (3, 4, 0, 2)),
        (ALONE, (2, 2), {"min_people": 3}, [], (0, 0, 4, 2)),
        # seen at the last two observed steps
        (
            SEEN,
            (2, 2),
            {"people": "present"},
            [
                {1: [0, 1, 2, 3], 2: [0, 1, 2, 3]},
                {1: [1, 2, 3, 4], 2: [1, 2, 3, None], 3: [1, 2, 3, 4], 5: [1, 2, None, 4]},
                {1: [2, 3, 4, 5], 2: [2, 3, None, None], 3: [2, 3, 4, 5]},
            ],
            (3, 9, 0, 3),
        ),
        # back over the whole history
        (
            {1: (0, 1, 2, 3, 4, 5), 2: (2, 3), 3: (0, 3, 4), 4: (0, 2, 3, 4)},
            (4, 1),
            {"people": "present", "min_people": 1},
            [
                {1: [0, 1, 2, 3, 4], 2: [None, None, 2, 3, None], 4: [0, None, 2, 3, 4]},
                {1: [1, 2, 3, 4, 5], 3: [None, None, 3, 4, None], 4: [None, 2, 3, 4, None]},
            ],
            None,
        ),
    ],
)
def test_people_of_every_window_by_hand(seen, steps, options, expected, counts):
    tracks = recording(seen)
    windows = cut_windows(tracks, *steps, **options)
    assert expected is None or listed(tracks, windows) == expected
    assert counts is None or windows.counts == WindowCounts(*counts)


def test_windows_know_where_tracks_end():
    tracks = recording(SEEN)
    windows = cut_windows(tracks, 2, 2)
    assert (tracks.agent[windows.end] == [1, 2, 1, 3, 1, 3]).all()
    assert (tracks.frame[windows.end] == [100, 30, 100, 100, 100, 100]).all()


def random_recording(seed: int) -> Tracks:
    random = np.random.default_rng(seed)
    seen = random.random((12, 30)) < 0.93
    seen &= np.abs(np.arange(30) - random.integers(30, size=(12, 1))) < random.integers(3, 25, size=(12, 1))
    seen[:, random.integers(30)] = False  # a step in which no person is seen is no step at all
    agent, step = np.nonzero(seen)
    return Tracks.from_table("random", np.column_stack((step * 10, agent * 7 + 3, agent, step)).astype(float))


def by_social_gans_loop(tracks: Tracks, obs_len: int, pred_len: int) -> list[list[tuple[int, list[int]]]]:
    """Cut windows as the paper's code does: frame lists, one after the other."""
    rows = np.column_stack((tracks.frame, tracks.agent))
    frames, length = np.unique(tracks.frame), obs_len + pred_len
    windows = []
    for i in range(len(frames) - length + 1):
        inside = np.isin(rows[:, 0], frames[i : i + length])
        people = []
        for agent in np.unique(rows[inside, 1]):
            own = np.flatnonzero(inside & (rows[:, 1] == agent))
            if len(own) == length:
                people.append((int(agent), own.tolist()))
        if len(people) > 1:
            windows.append(people)
    return windows


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("people", ["complete", "present"])
def test_random_recordings_agree_with_the_loop(seed, people):
    tracks = random_recording(seed)
    windows = cut_windows(tracks, 4, 3, people)
    result = [
        [(int(tracks.agent[rows.max()]), rows.tolist()) for rows in windows.rows[a:b] if (rows >= 0).all()]
        for a, b in zip(windows.offsets[:-1], windows.offsets[1:], strict=True)
    ]
    loop = by_social_gans_loop(tracks, 4, 3)
    assert len(loop) > 3
    if people == "complete":
        assert result == loop
    else:
        assert [scene for scene in result if len(scene) > 1] == loop
    frames = np.unique(tracks.frame)
    last_observed = frames[3 : len(frames) - 3]
    counts = windows.counts
    candidates = int(np.isin(tracks.frame, last_observed).sum())
    assert counts.people + counts.dropped_lone + counts.dropped_partial == candidates


def test_counts_are_printed_in_words_and_add_up():
    total = WindowCounts(3, 6, 0, 6) + WindowCounts(1, 2, 2, 2)
    assert total == WindowCounts(4, 8, 2, 8)
    assert str(total) == (
        "4 windows with 8 people (counted once per window); "
        "left out: 8 seen only in part of a window, 2 with too few others"
    )


def scenes_of(*tracks: Tracks, people: KeptPeople = "complete", min_people: int = 2) -> SceneSet:
    return SceneSet(
        [Recording(one) for one in tracks], [-1] * len(tracks), MapBank(), 2, 2, people, min_people
    )


SHORT, TINY = recording({1: (0, 1, 2), 2: (0, 1, 2)}, "short"), recording({1: (0, 1)}, "tiny")
LONE, PASSING = recording({7: (0, 1, 2, 3, 4)}, "alone"), recording({1: (0, 1, 2), 2: (1, 2, 3)}, "passing")


@pytest.mark.parametrize(
    ("tracks", "people", "words"),
    [
        ([SHORT], 2, r"2 \+ 2 = 4 steps.*'short' \(2 people, 3 steps\).*--data\.pred_len"),
        ([SHORT, TINY], 2, r"'short' \(2 people, 3 steps\), 'tiny' \(1 people, 2 steps\)"),
        ([LONE], 2, r"has 2 people.*'alone' \(1 people, 5 steps\).*--data\.min_people 1"),
        ([PASSING], 1, r"--data\.keep_people present keeps partly seen people"),
    ],
)
def test_no_window_is_refused_with_the_way_out(tracks, people, words):
    with pytest.raises(UserError, match=words):
        scenes_of(*tracks, min_people=people)
    assert scenes_of(LONE, min_people=1).sizes.tolist() == [1, 1]


def test_recordings_without_a_window_may_stand_beside_others():
    scenes = scenes_of(recording(SEEN, "a"), recording({1: (0, 1)}, "b"), recording(SEEN, "a"))
    assert [name for name, _ in scenes.counts] == ["a", "b", "a"]
    assert [counts.windows for _, counts in scenes.counts] == [3, 0, 3]
    assert len(scenes) == 6


TABLES = {  # (train windows, people), (val), (test), lone people of the test scene
    8: {
        "eth": ((3149, 34764), (765, 6520), (195, 614), 183),
        "hotel": ((2930, 33866), (733, 6304), (443, 1714), 167),
        "univ": ((2509, 11812), (667, 3547), (955, 27349), 0),
        "zara1": ((2692, 32686), (721, 6361), (702, 2875), 63),
        "zara2": ((2518, 30048), (642, 5365), (956, 6622), 62),
    },
    12: {
        "eth": ((2785, 29809), (660, 5349), (70, 181), 183),
        "hotel": ((2594, 29152), (621, 5136), (301, 1053), 144),
        "univ": ((2076, 9231), (530, 2708), (947, 24334), 0),
        "zara1": ((2322, 28010), (605, 5118), (602, 2253), 103),
        "zara2": ((2112, 25507), (501, 4173), (921, 5833), 77),
    },
}


@pytest.mark.parametrize("fold", list(TABLES[8]))
def test_eth_ucy_counts_equal_the_published_tables(shared, fold):
    dataset = EthUcy(fold, str(shared / "data"))
    splits: tuple[Split, ...] = ("train", "val", "test")
    recordings = {split: dataset.recordings(split) for split in splits}
    for pred_len, table in TABLES.items():
        counts = {
            split: sum((cut_windows(r.tracks, 8, pred_len).counts for r in recordings[split]), WindowCounts())
            for split in splits
        }
        assert tuple((counts[split].windows, counts[split].people) for split in splits) == table[fold][:3]
        assert counts["test"].dropped_lone == table[fold][3]


@pytest.mark.parametrize("people", ["complete", "present"])
def test_a_huge_recording_stays_small_in_memory(people):
    """2000 people at once for 20 s, 2.5 Hz after resampling: 100 000 rows."""
    frame, agent = (part.ravel() for part in np.meshgrid(np.arange(50), np.arange(2000)))
    tracks = Tracks("huge", frame.T.copy(), agent.copy(), np.zeros((len(frame), 2)))
    tracemalloc.start()
    scenes = SceneSet([Recording(tracks)], [-1], MapBank(), 8, 8, people)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert scenes.sizes.tolist() == [2000] * 35
    # the windows themselves: 35 * 2000 of 16 four-byte rows
    assert peak < 8 * (35 * 2000 * 16 * 4)


# Batches of scenes of similar size


SIZES = torch.randint(2, 40, (501,), generator=torch.Generator().manual_seed(0))
SIZES[17] = 150  # 22500 ordered pairs: more than any cap here


def epoch(sampler: BucketSampler, number: int = 0) -> list[Draw]:
    sampler.set_epoch(number)
    return list(sampler)


def scenes(draws: list[Draw]) -> list[list[int]]:
    return [draw.scenes.tolist() for draw in draws]


def drawn(number: int, shuffle: bool = True, **options: Any) -> list[list[int]]:
    return scenes(epoch(BucketSampler(SIZES, 64, 8192, shuffle, **options), number))


@pytest.mark.parametrize("shuffle", [True, False])
@pytest.mark.parametrize(
    ("batch_size", "max_pairs", "groups"),
    [(64, 10**9, 1), (64, 8192, 1), (1, 8192, 1), (1000, 10**9, 1), (16, 8192, 3)],
)
def test_every_scene_once_within_the_caps(shuffle, batch_size, max_pairs, groups):
    group = torch.arange(501) % groups * 10
    sampler = BucketSampler(SIZES, batch_size, max_pairs, shuffle, groups=group)
    for number in range(3):
        draws = epoch(sampler, number)
        assert len(draws) == len(sampler)
        assert sorted(scene for draw in draws for scene in draw.scenes.tolist()) == list(range(501))
        for draw in draws:
            assert len(draw.scenes) <= batch_size and len(group[draw.scenes].unique()) == 1
            assert (SIZES[draw.scenes] ** 2).sum() <= max_pairs or len(draw.scenes) == 1
    if max_pairs == 8192:
        assert [17] in scenes(draws)
    if groups == 1:
        assert scenes(draws) == scenes(epoch(BucketSampler(SIZES, batch_size, max_pairs, shuffle), 2))


def test_batches_are_full_and_of_similar_sizes():
    for draw, following in pairwise(epoch(BucketSampler(SIZES, 64, 8192, shuffle=False))):
        more = torch.cat((draw.scenes, following.scenes[:1]))
        assert len(more) > 64 or (SIZES[more] ** 2).sum() > 8192
    sizes = [SIZES[draw.scenes] for draw in epoch(BucketSampler(SIZES, 64, 16384, shuffle=True))]
    padded = sum(int(len(part) * part.max() ** 2) for part in sizes)
    assert padded < 1.2 * sum(int((part**2).sum()) for part in sizes)
    shuffled = sum(int(len(part) * part.max() ** 2) for part in SIZES[torch.randperm(501)].split(64))
    assert shuffled > 3 * padded


def test_an_epoch_depends_on_seed_and_number_only():
    first = BucketSampler(SIZES, 64, 8192, True, seed=1)
    epoch(first, 0)  # a resumed run has not drawn the earlier epochs
    fifth, sixth = epoch(first, 5), epoch(first, 6)
    assert scenes(fifth) == drawn(5, seed=1) and drawn(5, seed=2) != scenes(fifth) != scenes(sixth)
    assert [draw.seed for draw in fifth] == [draw.seed for draw in epoch(first, 5)]
    assert {draw.seed for draw in fifth}.isdisjoint(draw.seed for draw in sixth)
    still = BucketSampler(SIZES, 64, 8192, shuffle=False)
    assert drawn(0, shuffle=False) == drawn(1, shuffle=False)
    assert [draw.seed for draw in epoch(still, 0)] == [draw.seed for draw in epoch(still, 1)]


def test_shuffling_mixes_scenes_of_a_size_and_batches():
    one, two = drawn(0), drawn(1)
    assert {frozenset(batch) for batch in one} != {frozenset(batch) for batch in two}
    means = [float(SIZES[batch].float().mean()) for batch in one]
    assert means != sorted(means)


@pytest.mark.parametrize("replicas", [2, 3])
def test_processes_share_the_batches_evenly(replicas):
    alone = drawn(2, seed=4)
    shares = [drawn(2, seed=4, rank=rank, replicas=replicas) for rank in range(replicas)]
    assert {len(share) for share in shares} == {-(-len(alone) // replicas)}
    together = [batch for share in shares for batch in share]
    assert {tuple(batch) for batch in together} == {tuple(batch) for batch in alone}
    # only what fills the last round comes twice
    assert len(together) - len(alone) == -len(alone) % replicas
