"""GS-Dynamics as published: loss, gradients and skinning against the published formulas, written out here densely and with padding."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from twinbench.methods.gs_dynamics import GSDynamics, GSDynamicsAsPublished
from twinbench.methods.gs_dynamics.config import AS_PUBLISHED, CORRECTED, Config, Quirks
from twinbench.methods.gs_dynamics.skinning import node_rotations, skin

torch = pytest.importorskip("torch")
linear, relu = torch.nn.functional.linear, torch.relu

MOST, TOOLS, EDGES, STEPS, SEEN = 9, 2, 900, 5, 3
CONFIG = Config(quirks=AS_PUBLISHED, width=8, most_nodes=MOST)


# loss ------------------------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def batch():
    """Three windows of 4, 9 and 6 nodes and two tools each as dense arrays: rows of the body come first, those that are empty after them,
    tools last. ``state`` (B, 3, N, 3), noise on empty rows too; ``future`` and ``action`` (B, 5, N, 3); ``kind`` (B, N, 2); ``receive`` and
    ``send`` (B, 900, N), one row per edge, the rest 0."""
    random, nodes = np.random.default_rng(0), (4, 9, 6)
    rows = MOST + TOOLS
    path = random.uniform(-0.05, 0.05, (3, 1, rows, 3)) + random.normal(scale=0.01, size=(3, SEEN + STEPS, rows, 3)).cumsum(axis=1)
    kind, receive, send = np.zeros((3, rows, 2)), np.zeros((3, EDGES, rows)), np.zeros((3, EDGES, rows))
    kind[:, MOST:, 1] = 1
    for b, n in enumerate(nodes):
        path[b, :, n:MOST] = 0
        kind[b, :n, 0] = 1
        # every node listens to itself, to the next two of the body, and both ways with every tool
        joined = [(i, (i + k) % n) for i in range(n) for k in range(3)]
        joined += [pair for i in range(n) for t in range(MOST, rows) for pair in ((i, t), (t, i))]
        for row, (r, s) in enumerate(joined):
            receive[b, row, r] = send[b, row, s] = 1
    action = np.diff(path[:, SEEN - 1 :], axis=1) * kind[:, None, :, 1:]
    state = path[:, :SEEN] + random.uniform(-0.003, 0.003, (3, SEEN, rows, 3))
    made = dict(state=state, future=path[:, SEEN:], action=action, kind=kind, receive=receive, send=send)
    return {name: torch.as_tensor(array) for name, array in made.items()}


def mlp(layers, x):
    for k, layer in enumerate(layers):
        x = linear(relu(x) if k else x, layer.weight, layer.bias)
    return x


def published_step(network, state, action, kind, receive, send):
    """Next positions of the rows that are no tools, (B, 9, 3)."""
    parts = (network.node_encoder, network.edge_encoder, network.head)
    codes, edges, head = ([layer for layer in part if hasattr(layer, "weight")] for part in parts)
    heights, moved = state[..., 2].transpose(1, 2), state.diff(dim=1).transpose(1, 2).flatten(2)
    node = relu(mlp(codes, torch.cat([kind, heights, moved, action], dim=2)))
    of_receiver, of_sender = receive @ kind, send @ kind
    group = ((receive - send) @ kind[..., 1:]).abs()
    way = torch.cat([(receive - send) @ state[:, h] for h in range(SEEN)], dim=2)
    edge = relu(mlp(edges, torch.cat([of_receiver, of_sender, group, way], dim=2)))
    relation, particle = network.propagation.relation, network.propagation.particle
    hidden = node
    for _ in range(3):
        message = relu(linear(torch.cat([edge, receive @ hidden, send @ hidden], dim=2), relation.weight, relation.bias))
        total = receive.transpose(1, 2) @ message
        hidden = relu(linear(torch.cat([node, total], dim=2), particle.weight, particle.bias) + hidden)
    return state[:, -1, :MOST] + mlp(head, hidden[:, :MOST]).clamp(-100, 100)


def published_loss(network, batch, quirks):
    """Sum over five steps of mean |x - y|^2 over B x 9 x 3 entries plus 0.1 times that of edge lengths over B x 900, tool columns cut off.

    Without a quirk: means over rows and edges that are there; edges of the body alone; the gradient of the length before as well.
    """
    state, kind, receive, send = (batch[name] for name in ("state", "kind", "receive", "send"))
    real = kind[:, :MOST, :1]
    inner_edge = (receive + send)[..., :MOST].sum(2) * ((receive + send)[..., MOST:].sum(2) == 0) > 0
    ends = (receive - send)[..., :MOST]
    total = 0.0
    for step in range(STEPS):
        found = published_step(network, state, batch["action"][:, step], kind, receive, send)
        error = (found - batch["future"][:, step, :MOST]) ** 2
        before = state[:, 0, :MOST].detach() if quirks.detached_lengths else state[:, 0, :MOST]
        # |0| has a gradient of 0 in torch
        change = (torch.linalg.vector_norm(ends @ found, dim=2) - torch.linalg.vector_norm(ends @ before, dim=2)) ** 2
        if not quirks.origin_lengths:
            change = change * inner_edge
        lines = inner_edge.sum() if not quirks.origin_lengths else receive.sum()
        total = total + (error.mean() if quirks.diluted_loss else (error * real).sum() / (3 * real.sum()))
        total = total + 0.1 * (change.mean() if quirks.diluted_loss else change.sum() / lines)
        state = torch.cat([state[:, 1:], torch.cat([found, batch["future"][:, step, MOST:]], dim=1)[:, None]], dim=1)
    return total


def as_samples(batch, padding):
    """The same batch as this project holds it: rows that are there, tools, then empty rows if there is ``padding``."""
    from twinbench.methods.gs_dynamics.training import Sample, collate

    made = []
    for b in range(3):
        one = {name: array[b].numpy() for name, array in batch.items()}
        body, tool = one["kind"].T > 0
        empty = ~(body | tool)
        order = np.concatenate([np.flatnonzero(rows) for rows in (body, tool, empty)[: 3 if padding else 2]])
        there = one["receive"].any(axis=1)
        pairs = order.argsort()[np.searchsorted(np.sort(order), [one[end][there].argmax(axis=1) for end in ("send", "receive")])]
        made.append(Sample(*(one[name][:, order] for name in ("state", "future", "action")), tool[order], pairs, empty[order]))
    return collate(made)


def gradients(value, network):
    return torch.cat([g.flatten() for g in torch.autograd.grad(value, list(network.parameters()))])


@pytest.fixture(scope="module")
def network():
    from twinbench.methods.gs_dynamics.network import Network

    torch.manual_seed(0)
    return Network(CONFIG).double()


@pytest.mark.parametrize("flags", list(product([True, False], repeat=3)))
def test_loss_and_gradients_are_those_of_the_dense_formula(batch, network, flags):
    from twinbench.methods.gs_dynamics.training import loss

    quirks = replace(CORRECTED, **dict(zip(("diluted_loss", "origin_lengths", "detached_lengths"), flags, strict=True)))
    value = loss(network, as_samples(batch, quirks.diluted_loss), replace(CONFIG, quirks=quirks))
    expected = published_loss(network, batch, quirks)
    assert value.item() == pytest.approx(expected.item(), rel=1e-12)
    found, asked = gradients(value, network), gradients(expected, network)
    assert (found - asked).abs().max() < 1e-12 * asked.abs().max()  # float64, sums of some thousand terms in another order


def test_each_switch_of_the_loss_changes_what_the_formula_says(batch, network):
    whole = published_loss(network, batch, AS_PUBLISHED)
    asked = gradients(whole, network)
    for name in ("diluted_loss", "origin_lengths", "detached_lengths"):
        other = published_loss(network, batch, replace(AS_PUBLISHED, **{name: False}))
        assert (gradients(other, network) - asked).abs().max() > 1e-4 * asked.abs().max()
        assert (other.item() == whole.item()) == (name == "detached_lengths")  # it changes the gradient alone


def test_drawn_windows_are_filled_up_with_noisy_rows_that_should_stay_at_the_origin():
    from twinbench.methods.gs_dynamics.training import draw
    from twinbench.methods.gs_dynamics.windows import Clip

    random = np.random.default_rng(1)
    clip = Clip(random.uniform(0.1, 0.2, (8, 30, 3)), random.uniform(0.1, 0.2, (8, 2, 3)), ())
    window = np.arange(8), np.arange(30)
    for quirks in (AS_PUBLISHED, CORRECTED):
        sample = draw(clip, window, replace(CONFIG, quirks=quirks, most_nodes=40), np.random.default_rng(2))
        nodes = int((~sample.tool & ~sample.padding).sum())
        assert sample.tool.sum() == 2 and not sample.padding[sample.pairs].any() and 1 < nodes <= 30
        assert sample.padding.sum() == (40 - nodes if quirks is AS_PUBLISHED else 0)
        assert sample.tool[nodes : nodes + 2].all() and (np.abs(sample.history[:, : nodes + 2]) > 1e-3).any(axis=2).all()
    drawn = draw(clip, window, replace(CONFIG, most_nodes=40), np.random.default_rng(2))
    assert not drawn.future[:, drawn.padding].any() and not drawn.actions[:, drawn.padding].any()
    noise = drawn.history[:, drawn.padding]
    assert 0.0029 < np.abs(noise).max() <= 0.003 and abs(noise.mean()) < 3e-4  # some 300 uniform numbers of deviation 1.7e-3


# skinning --------------------------------------------------------------------------------------------------------------------------------


def published_rotation(old, new, one, others):
    """Of one node, in float32: F = sum over neighbours of e' e^T, by its rank as float32 has it."""
    e, now = ((x[others] - x[one]).astype(np.float32) for x in (old, new))
    f = torch.tensor(now.T @ e)
    rank = int(torch.linalg.matrix_rank(f))
    left, _, right = (part.double().numpy() for part in torch.linalg.svd(f))
    if rank == 0:
        return np.eye(3)
    if rank == 1:  # frames of x and of where the line lies now, which share the axis across both
        x, line = np.eye(3)[0], left[:, 0]
        across = np.cross(line, x)
        if np.linalg.norm(across) < 1e-6:
            return np.eye(3)
        across /= np.linalg.norm(across)
        frames = [np.stack([a, across, np.cross(a, across)], axis=1) for a in (x, line)]
        return frames[1] @ frames[0].T
    if rank == 3 and np.linalg.det(left @ right) < 0:
        return np.eye(3)
    return left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right


def bone(rank, seed, kind="turned"):
    """A node and six neighbours ``old`` and ``new`` (7, 3) [m] whose F has that ``rank``."""
    random = np.random.default_rng([rank, seed])
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    way = random.uniform(-0.05, 0.05, (7, rank)) @ axes[:rank]
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    if kind == "mirrored":
        turn = turn @ (np.eye(3) - 2 * np.outer(axes[0], axes[0]))
    if kind == "to x":
        turn = axes  # its rows are what way is along
    start = random.uniform(-0.3, 0.3, (2, 3))
    return way + start[0], way @ turn.T + start[1]


EVERY = np.array([[k, 0] for k in range(7)]).T  # senders and receivers: node 0 listens to all, itself included

CASES = [(rank, "turned") for rank in (0, 1, 2, 3)] + [(1, "mirrored"), (2, "mirrored"), (3, "mirrored"), (1, "to x")]


@pytest.mark.parametrize("rank, kind", CASES)
@pytest.mark.parametrize("seed", range(5))
def test_rotations_as_published_by_rank_and_handedness(rank, kind, seed):
    old, new = bone(rank, seed, kind)
    found = node_rotations(old, new, EVERY, AS_PUBLISHED)[0]
    expected = published_rotation(old, new, 0, np.arange(7))
    # float32 positions of some 0.1 m and arms of some cm: directions are known to about 1e-6, which F's condition multiplies
    np.testing.assert_allclose(found, expected, atol=1e-3 if rank == 3 else 1e-4)
    if kind == "to x" or rank == 0 or (rank, kind) == (3, "mirrored"):
        np.testing.assert_array_equal(found, np.eye(3))
    corrected = node_rotations(old, new, EVERY, CORRECTED)[0]
    assert np.linalg.det(corrected) == pytest.approx(1)
    if rank == 1:  # the line is carried along; as published only where it lay along x before
        np.testing.assert_allclose(corrected @ (old[1] - old[0]), new[1] - new[0], atol=1e-9)
    assert np.allclose(found, corrected, atol=1e-6) == (rank in (0, 2) or (rank, kind) == (3, "turned"))


@pytest.mark.parametrize("width, rank", [(0.03, 2), (0.003, 2), (1e-4, 1)])
def test_the_width_up_to_which_neighbours_lie_on_a_line(width, rank):
    # second over first singular value of F is (width / length)^2: 9e-4, 9e-6, 1e-8, on either side of float32's 3.6e-7 and of 1e-4;
    # only a node that has its rank follows a turn about the line
    along = np.linspace(-1, 1, 7)[:, None]
    old = along * [0, 0, 1] + width * (along**2 - 0.5) * [1, 0, 0]
    new = old @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).T
    e, now = old - old[3], new - new[3]
    assert int(torch.linalg.matrix_rank(torch.tensor(now.T @ e).float())) == rank
    pairs = np.array([[k, 3] for k in range(7)]).T
    for quirks, follows in ((CORRECTED, width > 0.01), (replace(CORRECTED, float32_rank=True), rank == 2)):
        turned = node_rotations(old, new, pairs, quirks)[3] @ [1, 0, 0]
        np.testing.assert_allclose(turned, [0, 1, 0] if follows else [1, 0, 0], atol=1e-6)


def test_points_are_carried_by_rotations_as_published():
    # x -> sum w (R (x - b) + b'), w = 1 / max(|x - b|, 1e-4) over all nodes, normalised: one node of each kind and its neighbours
    parts = [bone(rank, 9, kind) for rank, kind in CASES]
    old, new = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    pairs = np.concatenate([EVERY + 7 * k for k in range(len(parts))], axis=1)
    points = np.random.default_rng(5).uniform(-0.3, 0.3, (40, 3))
    rotations = np.tile(np.eye(3), (len(old), 1, 1))  # those that listen to nobody do not turn
    for k in range(len(parts)):
        rotations[7 * k] = published_rotation(old, new, 7 * k, np.arange(7 * k, 7 * k + 7))
    weights = 1 / np.maximum(np.linalg.norm(points[:, None] - old, axis=2), 1e-4)
    weights /= weights.sum(axis=1, keepdims=True)
    moved = np.einsum("nij,mnj->mni", rotations, points[:, None] - old) + new
    expected = (weights[..., None] * moved).sum(axis=1)
    found = skin(points, old, new, node_rotations(old, new, pairs, AS_PUBLISHED))
    np.testing.assert_allclose(found, expected, atol=1e-5)  # rotations in float32 at 0.3 m
    assert np.abs(skin(points, old, new, node_rotations(old, new, pairs)) - expected).max() > 1e-3


# which -----------------------------------------------------------------------------------------------------------------------------------


def test_both_methods_have_the_published_batches_and_every_switch_or_none():
    assert GSDynamics.presets["full"].batch == GSDynamicsAsPublished.presets["full"].batch == 64
    assert GSDynamicsAsPublished.presets["full"].quirks == Quirks() and GSDynamics.presets["full"].quirks == CORRECTED
