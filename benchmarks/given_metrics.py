"""Unit meshes in given metrics, beside Mmg2d, BAMG and Gmsh on the same metrics in one run.

    python benchmarks/given_metrics.py [--triangles 2000] [--only NAME ...] [--no-peers]

Five flat and five curved metrics, each on the unit square and on a polygon with a hole, scaled so
that the domain is worth a number of unit triangles. Lengths, qualities and counts are measured here
from the metric itself and share nothing with the package. Mmg2d needs mmgpy, BAMG the program
FreeFem++; each gets the exact metric at its current vertices in six passes, and its best counts.
"""

from __future__ import annotations

import argparse
import itertools
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import shapely
from scipy.spatial import Delaunay

import equimesh

Tensor = Callable[[np.ndarray, np.ndarray], np.ndarray]

POLYGON = shapely.Polygon(
    [(0, 0), (1, 0.05), (1.1, 0.6), (0.6, 1.0), (0.1, 0.8)],
    [[(0.4, 0.4), (0.6, 0.4), (0.6, 0.6), (0.4, 0.6)]],
)
DOMAINS = {"square": shapely.box(0, 0, 1, 1), "polygon": POLYGON}
PASSES = 6


def along(angle, size, across):
    """(n, 2, 2) unit lengths ``size`` at ``angle`` and ``across`` it."""
    c, s = np.cos(angle), np.sin(angle)
    a, b = np.broadcast_to(size, c.shape) ** -2.0, np.broadcast_to(across, c.shape) ** -2.0
    return matrix(a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c)


def matrix(a, b, d, c=None):
    rows = np.stack([a, b], -1), np.stack([b if c is None else c, d], -1)
    return np.stack(rows, -2)


def pulled_back(jacobian):
    """The metric of a map to flat coordinates: J^T J."""

    def tensor(x, y):
        j = jacobian(x, y)
        return j.transpose(0, 2, 1) @ j

    return tensor


def log_polar(x, y):
    """J of (log r, angle / 5) around a point outside: sizes proportional to r, 1 : 5."""
    u, v = x + 0.3, y + 0.3
    r2 = u * u + v * v
    return matrix(u / r2, v / r2, 0.2 * u / r2, -0.2 * v / r2)


def shock(x, y):
    """Thin across the curve y = 0.5 + 0.15 sin 3x, 1 : 50 on it."""
    nx, ny = -0.45 * np.cos(3 * x), np.ones_like(x)
    n = np.hypot(nx, ny)
    distance = np.abs(y - 0.5 - 0.15 * np.sin(3 * x)) / n
    return along(
        np.arctan2(ny, nx), 0.02 ** (1.0 / np.cosh(np.minimum(distance / 0.05, 30.0))), 1.0
    )


def hessian_like(x, y):
    """|H| of a function that is convex in places and a saddle in others, with a floor."""
    h = matrix(
        2.0 - 9.0 * np.sin(3 * x) * np.cos(2 * y),
        -6.0 * np.cos(3 * x) * np.sin(2 * y),
        0.5 - 4.0 * np.sin(3 * x) * np.cos(2 * y),
    )
    values, vectors = np.linalg.eigh(h)
    return np.einsum("nik,nk,njk->nij", vectors, np.hypot(values, 0.3), vectors)


FLAT: dict[str, Tensor] = {
    "constant 1:3": lambda x, y: along(0 * x + 0.3, 1.0, 0.3),
    "constant 1:30": lambda x, y: along(0 * x + 0.6, 1.0, 1.0 / 30.0),
    "pulled back": pulled_back(
        lambda x, y: matrix(
            1.0 + 0.6 * np.cos(3 * x + y), 0.2 * np.cos(3 * x + y), 1.0 + 0.5 * x + 0.8 * y, 0.5 * y
        )
    ),
    "harmonic conformal": lambda x, y: (
        np.exp(2.0 * (1.5 * x * y + x * x - y * y))[:, None, None] * np.eye(2)
    ),
    "wall layer 1:300": lambda x, y: along(0 * x, 0.3, 1e-3 * np.exp(5.7 * np.clip(y, -0.1, 1.1))),
}
CURVED: dict[str, Tensor] = {
    "sphere": lambda x, y: (
        (4.0 / (1.0 + 4.0 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)) ** 2)[:, None, None] * np.eye(2)
    ),
    "boundary layer 1:1000": lambda x, y: along(
        0 * x, 1.0, 1e-3 + 0.3 * np.abs(y) + 0.2 * x * y * y
    ),
    "shock 1:50": shock,
    "Hessian": hessian_like,
    "swirl": lambda x, y: along(
        4.0 * np.hypot(x - 0.5, y - 0.5) + np.arctan2(y + 0.5, x + 0.5), 0.2 + 0.1 * x, 1.0
    ),
}


def measured(tensor: Tensor, p, t):
    """Share of edges in [1/sqrt 2, sqrt 2], mean quality, count."""
    d01 = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    e = np.unique(np.sort(d01, axis=1), axis=0)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    d = p[e[:, 1]] - p[e[:, 0]]
    q = p[e[:, 0], None] + (0.5 + 0.5 * nodes)[None, :, None] * d[:, None]
    m = tensor(*q.reshape(-1, 2).T).reshape(len(e), 6, 2, 2)
    length = np.sqrt(np.einsum("ni,nqij,nj->nq", d, m, d)) @ (0.5 * weights)
    share = float(((length >= 0.5**0.5) & (length <= 2.0**0.5)).mean())
    corner = p[t]
    rule = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0
    q = np.einsum("qk,tkd->tqd", rule, corner)
    m = tensor(*q.reshape(-1, 2).T).reshape(len(t), 3, 2, 2).mean(1)
    side = corner - np.roll(corner, 1, axis=1)
    squares = np.einsum("tki,tij,tkj->t", side, m, side)
    u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    quality = 4.0 * 3.0**0.5 * area * np.sqrt(np.linalg.det(m)) / squares
    return share, float(quality.mean()), len(t), float(area.min())


def unit_count(tensor: Tensor, domain) -> float:
    """4 / sqrt 3 times the integral of sqrt det M, by midpoints of a fine grid of the box."""
    xmin, ymin, xmax, ymax = domain.bounds
    n = 3000
    x = xmin + (np.arange(n) + 0.5) / n * (xmax - xmin)
    y = ymin + (np.arange(n) + 0.5) / n * (ymax - ymin)
    shapely.prepare(domain)
    total = 0.0
    for row in np.array_split(y, 30):
        px, py = (a.ravel() for a in np.meshgrid(x, row))
        inside = shapely.contains_xy(domain, px, py)
        total += np.sqrt(np.linalg.det(tensor(px[inside], py[inside]))).sum()
    return 4.0 / 3.0**0.5 * total * (xmax - xmin) * (ymax - ymin) / n**2


def start(domain):
    """A plain mesh of a domain to start the others from: points, triangles, boundary, its sides."""
    rings = [domain.exterior, *domain.interiors]
    points, edges, tags = [], [], []
    count = tag = 0
    for ring in rings:
        corners = shapely.get_coordinates(ring)
        own = []
        for a, b in itertools.pairwise(corners):
            k = max(2, int(np.ceil(np.hypot(*(b - a)) / 0.05)))
            own.append(a + (np.arange(k) / k)[:, None] * (b - a))
            tag += 1
            tags += [tag] * k
        own = np.concatenate(own)
        i = count + np.arange(len(own))
        edges.append(np.stack([i, np.roll(i, -1)], 1))
        points.append(own)
        count += len(own)
    x, y = (a.ravel() for a in np.meshgrid(*(np.arange(-0.5, 1.5, 0.0471),) * 2))
    inner = np.stack([x, y], 1)
    far = shapely.distance(domain.boundary, shapely.points(inner)) > 0.025
    inner = inner[far & shapely.contains_xy(domain, x, y)]
    p = np.concatenate([*points, inner])
    t = Delaunay(p).simplices.astype(np.int64)
    t = t[shapely.contains_xy(domain, *p[t].mean(1).T)]
    return p, oriented(p, t), np.concatenate(edges), np.array(tags)


def oriented(p, t):
    u, v = p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]]
    turn = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.where((turn < 0.0)[:, None], t[:, [0, 2, 1]], t)[turn != 0.0]


def border_of(p, t):
    e = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    _, first, count = np.unique(np.sort(e, axis=1), axis=0, return_index=True, return_counts=True)
    return e[first[count == 1]]


def sides_of_edges(domain, p, edges):
    """(b,) which straight side of the domain an edge lies on."""
    middle = shapely.points(0.5 * (p[edges[:, 0]] + p[edges[:, 1]]))
    segments = []
    for ring in [domain.exterior, *domain.interiors]:
        c = shapely.get_coordinates(ring)
        segments += [shapely.LineString(s) for s in itertools.pairwise(c)]
    distance = np.stack([shapely.distance(s, middle) for s in segments], 1)
    return distance.argmin(1) + 1


def mmg2d_pass(p, t, m, domain):
    import mmgpy

    mesh = mmgpy.MmgMesh2D(np.ascontiguousarray(p), np.ascontiguousarray(t, np.int32))
    mesh["tensor"] = np.stack([m[:, 0, 0], m[:, 0, 1], m[:, 1, 1]], 1)
    mesh.remesh(verbose=-1, hgrad=-1.0)
    return np.array(mesh.get_vertices())[:, :2], np.array(mesh.get_triangles()).astype(np.int64)


SCRIPT = """verbosity=0;
mesh Th=readmesh("in.msh");
fespace Vh(Th,P1); Vh m11,m12,m22;
{ ifstream i("m.txt"); int n; i >> n;
  for(int k=0;k<n;k++){ real a,b,c; i>>a; i>>b; i>>c; m11[][k]=a; m12[][k]=b; m22[][k]=c; } }
mesh Tn=adaptmesh(Th,m11,m12,m22,IsMetric=1,iso=false,ratio=0,anisomax=1e6,hmin=1e-9,hmax=1e3,
  nbvx=400000,splitin2=false,splitpbedge=false,maxsubdiv=10,inquire=false);
savemesh(Tn,"out.msh");
"""


def bamg_pass(p, t, m, domain):
    edges = border_of(p, t)
    label = sides_of_edges(domain, p, edges)
    at = np.zeros(len(p), int)
    at[edges[:, 0]] = label
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open(folder / "in.msh", "w") as out:
            out.write(f"{len(p)} {len(t)} {len(edges)}\n")
            np.savetxt(out, np.column_stack([p, at]), fmt="%.17g %.17g %d")
            np.savetxt(out, np.column_stack([t + 1, 0 * t[:, 0]]), fmt="%d")
            np.savetxt(out, np.column_stack([edges + 1, label]), fmt="%d")
        with open(folder / "m.txt", "w") as out:
            out.write(f"{len(p)}\n")
            np.savetxt(out, np.stack([m[:, 0, 0], m[:, 0, 1], m[:, 1, 1]], 1), fmt="%.12g")
        (folder / "a.edp").write_text(SCRIPT)
        subprocess.run(
            ["FreeFem++", "-nw", "-v", "0", "a.edp"], cwd=folder, capture_output=True, check=True,
            timeout=120,
        )  # fmt: skip
        data = np.array((folder / "out.msh").read_text().split(), float)
    n, k = int(data[0]), int(data[1])
    points = data[3 : 3 + 3 * n].reshape(-1, 3)[:, :2]
    triangles = data[3 + 3 * n : 3 + 3 * n + 4 * k].reshape(-1, 4)[:, :3].astype(np.int64) - 1
    return points.copy(), triangles


def gmsh_pass(p, t, m, domain):
    import gmsh

    if not gmsh.isInitialized():
        gmsh.initialize(interruptible=False)
    option = gmsh.option.setNumber
    option("General.Terminal", 0)
    option("General.NumThreads", 1)
    gmsh.clear()
    gmsh.model.add("domain")
    view = gmsh.view.add("metric")
    corner = np.concatenate([p, np.zeros((len(p), 1))], 1)[t]
    nine = np.zeros((len(p), 9))
    nine[:, 0], nine[:, 1], nine[:, 3], nine[:, 4] = m[:, 0, 0], m[:, 0, 1], m[:, 0, 1], m[:, 1, 1]
    nine[:, 8] = 1.0
    data = [corner.transpose(0, 2, 1).reshape(len(t), 9), nine[t].reshape(len(t), 27)]
    gmsh.view.addListData(view, "TT", len(t), np.concatenate(data, 1).ravel())
    loops = []
    for ring in [domain.exterior, *domain.interiors]:
        c = shapely.get_coordinates(ring)[:-1]
        tags = [gmsh.model.geo.addPoint(*q, 0.0) for q in c]
        lines = [
            gmsh.model.geo.addLine(tags[i], tags[(i + 1) % len(tags)]) for i in range(len(tags))
        ]
        loops.append(gmsh.model.geo.addCurveLoop(lines))
    gmsh.model.geo.addPlaneSurface(loops)
    gmsh.model.geo.synchronize()
    field = gmsh.model.mesh.field.add("PostView")
    gmsh.model.mesh.field.setNumber(field, "ViewTag", view)
    gmsh.model.mesh.field.setAsBackgroundMesh(field)
    for name in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        option(f"Mesh.MeshSize{name}", 0)
    option("Mesh.Algorithm", 7)
    option("Mesh.AnisoMax", 1e33)
    option("Mesh.MeshSizeMin", 0)
    option("Mesh.MeshSizeMax", 1e22)
    gmsh.model.mesh.generate(2)
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType(2)
    index = np.full(int(tags.max()) + 1, -1)
    index[tags.astype(int)] = np.arange(len(tags))
    used, triangles = np.unique(index[nodes.astype(int)], return_inverse=True)
    return xyz.reshape(-1, 3)[used, :2], triangles.reshape(-1, 3).astype(np.int64)


PEERS = {"Mmg2d": mmg2d_pass, "BAMG": bamg_pass, "Gmsh": gmsh_pass}


def peer(step, tensor, domain):
    """The best pass, by the share of edges; None where the tool is missing or fails at once."""
    p, t, _, _ = start(domain)
    best = None
    for _ in range(PASSES):
        try:
            p, t = step(p, t, tensor(*p.T), domain)
        except Exception as error:  # noqa: BLE001  # whatever a tool raises, its last pass counts
            print(f"    ({step.__name__}: {str(error)[:90]})", file=sys.stderr)
            break
        t = oriented(p, t)
        found = measured(tensor, p, t)
        if best is None or found[0] > best[0]:
            best = found
    return best


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, default=2000)
    parser.add_argument("--only", nargs="*", default=None)
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--effort", default="balanced")
    options = parser.parse_args()
    peers = {} if options.no_peers else dict(PEERS)
    if shutil.which("FreeFem++") is None:
        peers.pop("BAMG", None)
    head = ["metric", "domain", "equimesh", "s", *peers]
    print("Share of edges in [1/sqrt 2, sqrt 2] / mean quality / triangles over unit triangles.\n")
    print(f"| {' | '.join(head)} |\n|{' --- |' * len(head)}")
    missed = 0
    for kind, metrics in (("flat", FLAT), ("curved", CURVED)):
        for name, raw in metrics.items():
            if options.only and not any(word in name for word in options.only):
                continue
            for place, domain in DOMAINS.items():
                scale = options.triangles / unit_count(raw, domain)

                def tensor(x, y, raw=raw, scale=scale):
                    return scale * raw(x, y)

                begin = time.perf_counter()
                result = equimesh.remesh(
                    equimesh.Metric(tensor), domain=domain, effort=options.effort
                )
                seconds = time.perf_counter() - begin
                own = measured(tensor, result.points[:, :2], result.triangles)
                others = {tool: peer(step, tensor, domain) for tool, step in peers.items()}
                good = own[0] >= 0.98 and own[1] >= 0.95 and own[3] > 0.0
                good &= abs(own[2] / options.triangles - 1.0) <= 0.04
                good &= all(o is None or own[0] >= o[0] for o in others.values())
                missed += not good

                def told(found):
                    if found is None:
                        return "-"
                    return f"{found[0]:.4f} / {found[1]:.4f} / {found[2] / options.triangles:.3f}"

                row = [f"{kind}: {name}", place, told(own), f"{seconds:.1f}"]
                row += [told(o) for o in others.values()]
                print(f"| {' | '.join(row)} |{'' if good else ' missed'}", flush=True)
    print(f"\n{missed} missed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
