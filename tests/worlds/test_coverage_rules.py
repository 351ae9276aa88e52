"""What the graph G may use of a radio map: §1.6, §1.7, §1.8."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.worlds.floors import grid_floor, world
from tests.worlds.radio_maps import FOUR, paper_floor, tiny
from worlds.errors import WorldError
from worlds.radio_map import build_radio_map, kept_edges, kept_vertices

HOLE, GOOD = 5.0, 20.0


def test_a_hole_between_the_ends_counts_under_samples_only() -> None:
    """§1.7: A_e asks every sample under `samples`, and A_v ∩ A_u under `endpoints`."""
    line = [[[GOOD], [HOLE], [GOOD]]]
    for rule, covered in (("samples", False), ("endpoints", True)):
        radio_map, floor = tiny(line, rule)
        np.testing.assert_array_equal(radio_map.edge_covered, [[covered]])
        np.testing.assert_array_equal(radio_map.edge_holes, [[True]])
        np.testing.assert_array_equal(kept_edges(floor, radio_map), [0] if covered else [])
        np.testing.assert_array_equal(kept_vertices(radio_map), [0, 1])


def test_a_handover_needs_one_of_both_at_each_sample() -> None:
    """§1.7: a→b needs a at u, b at v, and a or b at each sample in between."""
    #        u: a only        middle: b only    v: b only
    line = [[[GOOD, HOLE], [HOLE, GOOD], [HOLE, GOOD]]]
    radio_map, floor = tiny(line)
    np.testing.assert_array_equal(radio_map.edge_covered, [[False, False]])
    np.testing.assert_array_equal(radio_map.edge_handover(floor), [[[False, True], [False, False]]])
    np.testing.assert_array_equal(kept_edges(floor, radio_map), [0])


def test_a_third_ap_may_keep_an_edge_in_g_that_nobody_can_hand_over_on() -> None:
    """§1.8 asks for any AP at each sample, §1.7 for one of the two that take turns."""
    line = [[[GOOD, HOLE, HOLE], [HOLE, HOLE, GOOD], [HOLE, GOOD, HOLE]]]
    radio_map, floor = tiny(line)
    assert not radio_map.edge_handover(floor).any()
    np.testing.assert_array_equal(kept_edges(floor, radio_map), [0])
    free = dataclasses.replace(radio_map, edge_rule="endpoints")
    assert free.edge_handover(floor)[0, 0, 1]
    assert free.edge_handover(floor).sum() == 1


def test_under_endpoints_every_handover_is_allowed() -> None:
    """§1.7: all pairs of different APs, the first covering u, the second v."""
    line = [[[GOOD, GOOD, HOLE], [HOLE, HOLE, HOLE], [GOOD, HOLE, GOOD]]]
    radio_map, floor = tiny(line, "endpoints")
    expected = np.zeros((1, 3, 3), dtype=bool)
    expected[0, 0, 2] = expected[0, 1, 0] = expected[0, 1, 2] = True
    np.testing.assert_array_equal(radio_map.edge_handover(floor), expected)
    np.testing.assert_array_equal(radio_map.edge_covered, [[True, False, False]])


def test_a_vertex_nobody_covers_is_not_in_g_nor_are_its_edges() -> None:
    """§1.8: only covered vertices, and edges covered at every sample."""
    line = [
        [[GOOD, HOLE], [GOOD, GOOD], [HOLE, GOOD]],
        [[HOLE, GOOD], [HOLE, GOOD], [HOLE, HOLE]],
    ]
    for rule in ("samples", "endpoints"):
        radio_map, floor = tiny(line, rule)
        np.testing.assert_array_equal(kept_vertices(radio_map), [0, 1])
        np.testing.assert_array_equal(kept_edges(floor, radio_map), [0])


def test_the_threshold_itself_is_covered() -> None:
    """§1.6, §1.7: a vertex, and a sample of an edge, counts as covered from the threshold on."""
    below = float(np.nextafter(10.0, 0.0))
    radio_map, _ = tiny([[[10.0, 10.0], [10.0, below], [10.0, below]]])
    np.testing.assert_array_equal(radio_map.covered, [[True, True], [True, False]])
    np.testing.assert_array_equal(radio_map.edge_covered, [[True, False]])


@pytest.mark.parametrize("rule", ["samples", "endpoints"])
def test_coverage_rules_hold_on_a_real_hall_taken_literally(rule: str) -> None:
    """§1.7 and §1.8 word by word, edge by edge and pair by pair, on the paper's hall."""
    floor = paper_floor(9)
    found = build_radio_map(world(FOUR, shadow_fading=True, edge_rule=rule), floor)
    handover, whole = found.edge_handover(floor), found.edge_covered
    kept = set(kept_edges(floor, found).tolist())
    for e, (u, v) in enumerate(floor.edge_uv.tolist()):
        at = [set(np.flatnonzero(row >= 10.0).tolist()) for row in found.edge_snr_db[e]]
        a_u, a_v = (set(np.flatnonzero(found.snr_db[x] >= 10.0).tolist()) for x in (u, v))
        looked_at = at if rule == "samples" else [a_u, a_v]
        assert (e in kept) == all(looked_at)
        for a in range(4):
            assert whole[e, a] == all(a in here for here in looked_at)
            for b in range(4):
                allowed = a != b and a in a_u and b in a_v
                if rule == "samples":
                    allowed = allowed and all(here & {a, b} for here in at)
                assert handover[e, a, b] == allowed


def test_another_floors_map_is_refused() -> None:
    """A map whose edges are not the floor's is an error, not an index out of range."""
    radio_map, _ = tiny([[[20.0], [15.0], [10.0]]])
    with pytest.raises(WorldError, match="made for another floor"):
        kept_edges(grid_floor(5, 5), radio_map)
