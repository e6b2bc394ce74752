from itertools import pairwise

import numpy as np

from simgrab.dataset.video.transmission import slots
from simgrab.model.scenario import Clip, Scenario


def plan(**clip):
    frames = clip.pop("frames", 4000)
    return list(slots(Scenario(frames=frames, clip=Clip(**clip)), 0, 90_000))


def test_shares_and_jitter_are_what_was_set():
    lost = [slot.pts is None for slot in plan(drop_share=0.1)]
    late = [slot.repeated for slot in plan(repeat_share=0.3)]
    assert abs(np.mean(lost) - 0.1) < 4 * np.sqrt(0.1 * 0.9 / 4000)
    assert abs(np.mean(late) - 0.3) < 4 * np.sqrt(0.3 * 0.7 / 4000)
    shaken = plan(jitter_ms=10.0)
    delays_ms = np.array([slot.pts / 90 - slot.time_s * 1000 for slot in shaken[1:]])
    assert abs(np.std(delays_ms) - 10) < 4 * 10 / np.sqrt(2 * 4000)
    assert abs(np.mean(delays_ms)) < 4 * 10 / np.sqrt(4000)


def test_what_befalls_one_frame_changes_no_other():
    """A longer clip begins with the shorter, and one setting leaves the others' draws alone."""
    both = plan(drop_share=0.2, repeat_share=0.2, jitter_ms=5.0)
    assert plan(drop_share=0.2, repeat_share=0.2, jitter_ms=5.0, frames=100) == both[:100]
    assert [s.pts is None for s in plan(drop_share=0.2)] == [s.pts is None for s in both]
    late = [s.repeated for s in plan(repeat_share=0.2)]
    assert all(a == b.repeated for a, b in zip(late, both, strict=True) if b.pts is not None)


def test_time_never_runs_back():
    """However strong the jitter; and every clip begins with a picture, at 0."""
    for seed in range(20):
        scenario = Scenario(seed=seed, frames=50, clip=Clip(drop_share=0.9, repeat_share=0.9, jitter_ms=1000.0))
        first, *rest = slots(scenario, 0, 1000)
        assert (first.pts, first.repeated) == (0, False)
        times = [0, *(slot.pts for slot in rest if slot.pts is not None)]
        assert all(a < b for a, b in pairwise(times))


def test_clips_cut_the_frames_without_rest():
    for frames, length in ((24, 10), (20, 10), (5, 10), (7, 0), (1, 1)):
        clip = Clip(clip_frames=length)
        spans = [clip.span(c, frames) for c in range(clip.count(frames))]
        assert [frame for span in spans for frame in span] == list(range(frames))
        assert all(clip.of(frame) == c for c, span in enumerate(spans) for frame in span)
