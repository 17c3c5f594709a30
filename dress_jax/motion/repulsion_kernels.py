"""Host kernels of `repulsion`: normals, pairs that have come near, and the iterations of XPBD."""

import numpy as np
from jaxtyping import Float, Int

from dress_jax.core.native import compiled

_FACING = 0.0  # cosine of the angle between normals below which two places face each other


@compiled
def vertex_normals(x: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"]):
    """Area-weighted unit normals, zero where there is no area."""
    normals = np.zeros_like(x)
    for row in range(faces.shape[0]):
        a, b, c = faces[row, 0], faces[row, 1], faces[row, 2]
        ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in (a, b, c):
            normals[corner, 0] += nx
            normals[corner, 1] += ny
            normals[corner, 2] += nz
    for row in range(x.shape[0]):
        length = (normals[row, 0] ** 2 + normals[row, 1] ** 2 + normals[row, 2] ** 2) ** 0.5
        if length > 0.0:
            for k in range(3):
                normals[row, k] /= length
    return normals


@compiled
def _middle_distance(x, v, faces, f):
    """Of a vertex from the centroid of a face [m]."""
    total = 0.0
    for k in range(3):
        middle = (x[faces[f, 0], k] + x[faces[f, 1], k] + x[faces[f, 2], k]) / 3.0
        total += (x[v, k] - middle) ** 2
    return total**0.5


@compiled
def _near_pairs(
    x, faces, normals, centres, rest, rest_centres, order, starts, grid, cells, reach, closer, pairs
):
    """Count the pairs of `near_pairs`; rows go to `pairs` while they fit."""
    count = 0
    for v in range(x.shape[0]):
        for i in range(max(cells[v, 0] - 1, 0), min(cells[v, 0] + 2, grid[0])):
            for j in range(max(cells[v, 1] - 1, 0), min(cells[v, 1] + 2, grid[1])):
                first = (i * grid[1] + j) * grid[2]
                low, high = max(cells[v, 2] - 1, 0), min(cells[v, 2] + 2, grid[2])
                # Cells along the last axis follow one another.
                for entry in range(starts[first + low], starts[first + high]):
                    f = order[entry]
                    now, then, cosine = 0.0, 0.0, 0.0
                    for k in range(3):
                        now += (x[v, k] - centres[f, k]) ** 2
                        then += (rest[v, k] - rest_centres[f, k]) ** 2
                    if now > reach * reach or then <= closer * closer * now:
                        continue
                    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                    if a == v or b == v or c == v:
                        continue
                    for k in range(3):
                        mean = normals[a, k] + normals[b, k] + normals[c, k]
                        cosine += normals[v, k] * mean
                    if cosine >= 3.0 * _FACING:
                        continue
                    if count < pairs.shape[0]:
                        pairs[count, 0], pairs[count, 1] = v, f
                    count += 1
    return count


def near_pairs(
    x: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    rest: Float[np.ndarray, "n 3"],
    *,
    reach: float,
    closer: float,
) -> Int[np.ndarray, "k 2"]:
    """Vertices and faces that face each other and are much nearer than at rest.

    Distances are those of a vertex from the centroid of a face; a face's normal is the mean of its
    corners' here.

    Args:
        x: positions [m].
        faces: triangles.
        rest: positions at rest [m].
        reach: largest distance of a vertex from a face [m].
        closer: how many times nearer than at rest.

    Returns:
        Rows [vertex, face], by vertex.
    """
    centres, rest_centres = x[faces].mean(axis=1), rest[faces].mean(axis=1)
    reach += float(np.linalg.norm(x[faces] - centres[:, None], axis=2).max())
    origin = x.min(axis=0)
    cells = ((x - origin) / reach).astype(np.int64)
    grid = cells.max(axis=0) + 1
    own = ((centres - origin) / reach).astype(np.int64)
    keys = (own[:, 0] * grid[1] + own[:, 1]) * grid[2] + own[:, 2]
    order = np.argsort(keys, kind="stable")
    starts = np.searchsorted(keys[order], np.arange(int(np.prod(grid)) + 1))
    normals = vertex_normals(x, faces)
    pairs = np.empty((1 << 14, 2), np.int64)
    arguments = (x, faces, normals, centres, rest, rest_centres, order, starts, grid, cells)
    while True:
        count = _near_pairs(*arguments, reach, closer, pairs)
        if count <= len(pairs):
            return pairs[:count]
        pairs = np.empty((count, 2), np.int64)


@compiled
def _closest_weights(p, a, b, c):
    """Barycentric coordinates of the point of a triangle nearest to p (Ericson 2005, 5.1.5)."""
    abx, aby, abz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    acx, acy, acz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    apx, apy, apz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    bpx, bpy, bpz = p[0] - b[0], p[1] - b[1], p[2] - b[2]
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0
    cpx, cpy, cpz = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return 1.0 - t, 0.0, t
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - t, t
    total = 1.0 / (va + vb + vc)
    return 1.0 - (vb + vc) * total, vb * total, vc * total


@compiled
def closest_contacts(x, faces, normals, pairs, rest, gap, depth, closer, rest_gap):
    """Of the pairs of each vertex the nearest one that still counts, as a constraint.

    Args:
        x: positions [m], (n, 3).
        faces: (f, 3).
        normals: of the vertices, (n, 3).
        pairs: rows [vertex, face], sorted.
        rest: positions at rest [m].
        gap, depth: [m].
        closer: how many times nearer than at rest a pair is.
        rest_gap: largest gap over the distance at rest.

    Returns:
        Vertex and corners (m, 4), weights of the corners (m, 3), directions (m, 3), gaps (m,).
    """
    points = np.empty((pairs.shape[0], 4), np.int64)
    weights = np.empty((pairs.shape[0], 3))
    directions = np.empty((pairs.shape[0], 3))
    gaps = np.empty(pairs.shape[0])
    count = 0
    row = 0
    while row < pairs.shape[0]:
        v = pairs[row, 0]
        best, chosen = np.inf, -1
        wa, wb, wc = 0.0, 0.0, 0.0
        while row < pairs.shape[0] and pairs[row, 0] == v:
            f = pairs[row, 1]
            a, b, c = x[faces[f, 0]], x[faces[f, 1]], x[faces[f, 2]]
            ta, tb, tc = _closest_weights(x[v], a, b, c)
            squared, cosine = 0.0, 0.0
            for k in range(3):
                squared += (x[v, k] - ta * a[k] - tb * b[k] - tc * c[k]) ** 2
                cosine += normals[v, k] * (
                    ta * normals[faces[f, 0], k]
                    + tb * normals[faces[f, 1], k]
                    + tc * normals[faces[f, 2], k]
                )
            at_rest = _middle_distance(rest, v, faces, f)
            near = at_rest > closer * squared**0.5
            if near and cosine < _FACING and squared < best:
                best, chosen = squared, f
                wa, wb, wc = ta, tb, tc
            row += 1
        if chosen < 0:
            continue
        f = chosen
        # The outward side of the surface there.
        n = np.empty(3)
        offset = np.empty(3)
        length, signed = 0.0, 0.0
        for k in range(3):
            n[k] = (
                wa * normals[faces[f, 0], k]
                + wb * normals[faces[f, 1], k]
                + wc * normals[faces[f, 2], k]
            )
            length += n[k] ** 2
            offset[k] = (
                x[v, k] - wa * x[faces[f, 0], k] - wb * x[faces[f, 1], k] - wc * x[faces[f, 2], k]
            )
            signed += n[k] * offset[k]
        distance = best**0.5
        if length == 0.0 or (signed < 0.0 and distance > depth):
            continue
        own = min(gap, rest_gap * _middle_distance(rest, v, faces, f))
        if signed > 0.0 and distance > own:
            continue
        for k in range(3):
            if signed > 0.0 and distance > 1e-9:
                directions[count, k] = offset[k] / distance
            else:
                directions[count, k] = n[k] / length**0.5
        points[count, 0] = v
        weights[count, 0], weights[count, 1], weights[count, 2] = wa, wb, wc
        for k in range(3):
            points[count, 1 + k] = faces[f, k]
        gaps[count] = own
        count += 1
    return points[:count], weights[:count], directions[:count], gaps[:count]


@compiled
def relax(d, posed, edges, points, weights, directions, gaps, iterations, edge, anchor):
    """Iterations of XPBD on displacements d, in place; see `repulsion`.

    Args:
        d: displacements [m], (n, 3).
        posed: positions without them [m], (n, 3).
        edges: (e, 2).
        points, weights, directions, gaps: of the contacts, from `closest_contacts`.
        iterations: how many.
        edge, anchor: compliances, for unit masses and a unit time step.
    """
    along = np.zeros((edges.shape[0], 3))
    held = np.zeros((d.shape[0], 3))
    pushed = np.zeros(points.shape[0])
    for iteration in range(iterations):
        for number in range(edges.shape[0]):
            # In turns from either end, so that no direction is preferred.
            row = number if iteration % 2 == 0 else edges.shape[0] - 1 - number
            i, j = edges[row, 0], edges[row, 1]
            for k in range(3):
                change = -(d[i, k] - d[j, k] + edge * along[row, k]) / (2.0 + edge)
                along[row, k] += change
                d[i, k] += change
                d[j, k] -= change
        for row in range(d.shape[0]):
            for k in range(3):
                change = -(d[row, k] + anchor * held[row, k]) / (1.0 + anchor)
                held[row, k] += change
                d[row, k] += change
        for row in range(points.shape[0]):
            v = points[row, 0]
            value, inverse = -gaps[row], 1.0
            for k in range(3):
                place = posed[v, k] + d[v, k]
                for corner in range(3):
                    u = points[row, 1 + corner]
                    place -= weights[row, corner] * (posed[u, k] + d[u, k])
                value += directions[row, k] * place
            for corner in range(3):
                inverse += weights[row, corner] ** 2
            push = max(pushed[row] - value / inverse, 0.0) - pushed[row]
            pushed[row] += push
            for k in range(3):
                d[v, k] += push * directions[row, k]
                for corner in range(3):
                    u = points[row, 1 + corner]
                    d[u, k] -= push * weights[row, corner] * directions[row, k]
