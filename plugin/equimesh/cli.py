"""The command line: ``equimesh remesh``, ``equimesh profile`` and ``equimesh paper``.

Exit status: 0 when the tolerance is met and the files are written, 1 with one sentence on stderr
when they are not, 2 for wrong usage, 3 when the files are written but ``--max-triangles`` ended the
run before the tolerance.
"""

from __future__ import annotations

import contextlib
import enum
import logging
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from equimesh import arguments, formats, outputs, plot, report
from equimesh.errors import Cancelled, InputError
from equimesh.fields.surface import Surface

__all__ = ["app", "main"]

_LIMITED = 3  # exit status

app = typer.Typer(
    help="The fewest triangles for a surface z = f(x, y) within a certified tolerance.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


class Fit(enum.StrEnum):
    interpolate = "interpolate"
    best = "best"


class Effort(enum.StrEnum):
    fast = "fast"
    balanced = "balanced"
    best = "best"


class Bound(enum.StrEnum):
    surface = "surface"
    samples = "samples"


class Norm(enum.StrEnum):
    max = "max"
    L1 = "L1"
    L2 = "L2"
    gradient = "gradient"


FunctionOption = Annotated[
    str | None, typer.Option("--function", metavar="EXPR", help='Such as "exp(5*x)*sin(5*y)".')
]
DomainOption = Annotated[
    str | None,
    typer.Option(metavar="D", help="xmin,ymin,xmax,ymax, a polygon as WKT, or a .geojson file."),
]
UpOption = Annotated[
    str | None,
    typer.Option(metavar="DIR", help="Height axis of a surface: x, y, z or three numbers."),
]
BandOption = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Which band of a raster, from 1.")
]
HolesOption = Annotated[
    str | None,
    typer.Option("--fill-holes", metavar="SIZE", help='Of a surface: an area, "40 edges" or all.'),
]
BoundOption = Annotated[
    Bound | None,
    typer.Option(help="Of a raster: errors count on the surface, or at the samples only."),
]
ReportOption = Annotated[
    Path | None, typer.Option("--report", metavar="R.json", help="Write all figures here.")
]
PlotOption = Annotated[
    Path | None, typer.Option("--plot", metavar="P.png", help="Draw mesh and error profile.")
]


@app.callback(invoke_without_command=True)
def _root(
    show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if show_version:
        typer.echo(report.installed_version() or "not installed")
        raise typer.Exit


@app.command()
def remesh(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="[INPUT] OUTPUT", help="INPUT is left out with --function."),
    ],
    tol: Annotated[
        str | None, typer.Option(metavar="TOL", help="A height, or 1% of the range of heights.")
    ] = None,
    target: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="This many triangles instead of --tol.")
    ] = None,
    most: Annotated[
        int | None,
        typer.Option(
            "--max-triangles",
            min=2,
            metavar="N",
            help="Beside --tol: no more than these; exit status 3 if they do not reach it.",
        ),
    ] = None,
    function: FunctionOption = None,
    domain: DomainOption = None,
    breaklines: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Lines to be edges, points to be vertices."),
    ] = None,
    fit: Annotated[
        Fit, typer.Option(help="best: vertices may leave the surface, within the tolerance.")
    ] = Fit.interpolate,
    min_angle: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="No smaller angles than this, at most 30 degrees."),
    ] = None,
    norm: Annotated[
        Norm, typer.Option(help="Of a function: the norm of the error that --tol bounds.")
    ] = Norm.max,
    effort: Annotated[Effort, typer.Option(help="Time against triangles.")] = Effort.balanced,
    up: UpOption = None,
    band: BandOption = None,
    bound: BoundOption = None,
    holes: HolesOption = None,
    seed: Annotated[int, typer.Option(help="Same input and seed, same mesh.")] = 0,
    report_file: ReportOption = None,
    plot_file: PlotOption = None,
) -> None:
    """Mesh INPUT, or a function over a domain, and write the triangles to OUTPUT."""
    if len(files) != (1 if function is not None else 2):
        raise typer.BadParameter("give INPUT and OUTPUT, or --function and OUTPUT")
    if (tol is None) == (target is None):
        raise typer.BadParameter("give either --tol or --target")
    if most is not None and tol is None:
        raise typer.BadParameter("give --tol with --max-triangles")
    with _plain_errors():
        *inputs, output = files
        formats.writer(output)
        _check_outputs(inputs, [output, report_file, plot_file], plot_file)
        started = time.perf_counter()
        field = _source(inputs[0] if inputs else None, function, up, band, holes)
        read = time.perf_counter() - started
        region = None if domain is None else arguments.region(domain)

        import equimesh

        with _progress_bar() as progress:
            result = equimesh.remesh(
                field, tol, region, target=target, max_triangles=most, fit=fit.value,
                effort=effort.value, seed=seed, progress=progress,
                bound=None if bound is None else bound.value,
                constraints=() if breaklines is None else breaklines, min_angle=min_angle,
                norm=norm.value,
            )  # fmt: skip
        if not result.status.usable:
            raise InputError(result.status.value)
        figures = report.of_result(result, {"read": read, **result.timings})
        placed = formats.in_space(result, field)
        written = formats.files_of(output, placed)
        if plot_file is not None:
            line = result.tol if norm is Norm.max else None  # others are not of one triangle
            written[plot_file] = lambda path: plot.save_plot(path, result.profile, line)
        _finish(written, figures, report_file)
        _show(figures, function or result.input_size, [*getattr(field, "notes", ()), *result.notes])
    if not result.status.ok:
        raise typer.Exit(_LIMITED)


@app.command()
def profile(
    mesh: Annotated[Path, typer.Argument(metavar="MESH", help="A triangle mesh from any program.")],
    against: Annotated[
        Path | None, typer.Option(metavar="INPUT", help="The surface that the mesh stands for.")
    ] = None,
    function: FunctionOption = None,
    up: UpOption = None,
    band: BandOption = None,
    bound: BoundOption = None,
    holes: HolesOption = None,
    report_file: ReportOption = None,
    plot_file: PlotOption = None,
) -> None:
    """Measure the error of every triangle of MESH.

    A mesh whose heights are all zero is taken as flat, with its heights on the surface.
    """
    if (against is None) == (function is None):
        raise typer.BadParameter("give either --against or --function")
    with _plain_errors():
        _check_outputs([mesh], [report_file, plot_file], plot_file)
        started = time.perf_counter()
        points, triangles = formats.load_mesh(mesh)
        notes = []
        if points.shape[1] == 3 and not points[:, 2].any():
            points = points[:, :2]
            notes.append("the mesh is flat: its heights were taken from the surface")
        field = _source(against, function, up, band, holes)
        read = time.perf_counter()

        import equimesh

        surface = equimesh.as_field(field, bound=None if bound is None else bound.value)
        points = formats.in_projection(points, field)
        measured = equimesh.profile(points, triangles, surface)
        at_samples = None
        if isinstance(surface, equimesh.Raster) and measured.over == "surface":
            at_samples = equimesh.profile(points, triangles, surface, "samples")
        seconds = {"read": read - started, "profile": time.perf_counter() - read}
        figures = report.of_profile(measured, seconds, at_samples)
        written: dict[Path, Callable[[Path], object]] = {}
        if plot_file is not None:
            written[plot_file] = lambda path: plot.save_plot(path, measured)
        _finish(written, figures, report_file)
        _show(figures, str(mesh), notes)


@app.command()
def paper(
    folder: Annotated[Path, typer.Argument(metavar="OUTDIR", help="Where the page is to go.")],
) -> None:
    """Make the tables and figures of D'Azevedo (1991) again, as a page with pictures."""
    with _plain_errors():
        from equimesh.paper import reproduce

        reproduce(folder)


def main() -> None:
    """The program ``equimesh``."""
    # Libraries' own remarks would blur the one sentence that an error is to have.
    warnings.simplefilter("ignore")
    logging.getLogger().addHandler(logging.NullHandler())
    # A polite kill ends like Ctrl-C, so that drafts of files are removed.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    app()


@contextlib.contextmanager
def _plain_errors() -> Iterator[None]:
    """Trouble that a user can have becomes one sentence on stderr and exit status 1."""
    try:
        yield
    except InputError as error:
        _stop(str(error))
    except (KeyboardInterrupt, Cancelled):
        _stop("Interrupted: nothing was written.")
    except MemoryError:
        _stop("There is not enough memory: give a larger tolerance or a smaller input.")
    except OSError as error:
        _stop(f"The system refuses ({error}): check the files' names and the space left.")


def _stop(sentence: str) -> NoReturn:
    typer.echo(" ".join(sentence.split()), err=True)
    raise typer.Exit(1)


def _source(
    path: Path | None, function: str | None, up: str | None, band: int | None, holes: str | None
) -> Any:
    direction = None if up is None else arguments.direction(up)
    if function is None:
        assert path is not None
        field = formats.load(path, up=direction, band=band)
        if holes is None:
            return field
        if not isinstance(field, Surface):
            raise InputError("--fill-holes is for surfaces: leave it out for a raster.")
        return field.closed(holes)
    if holes is not None:
        raise InputError("--fill-holes is for surfaces: leave it out with --function.")
    if direction is not None:
        raise InputError("--up is for surfaces: leave it out with --function.")
    if band is not None:
        raise InputError("--band is for rasters: leave it out with --function.")
    from equimesh.fields.function import Function

    return Function(function)


def _check_outputs(inputs: list[Path], targets: list[Path | None], plot_file: Path | None) -> None:
    """Everything that could prevent writing, found before the long work."""
    if plot_file is not None:
        plot.check_plot(plot_file)
    seen = [path.resolve() for path in inputs]
    for target in filter(None, targets):
        if target.resolve() in seen:
            raise InputError(f"{target} is named twice: give each file its own name.")
        seen.append(target.resolve())
        outputs.check_writable(target)


def _finish(
    written: dict[Path, Callable[[Path], object]], figures: dict[str, Any], report_file: Path | None
) -> None:
    """Write every file; none of them appears unless all do."""
    started = time.perf_counter()
    with outputs.staged([*written, *([report_file] if report_file else [])]) as drafts:
        for draft, write in zip(drafts, written.values(), strict=False):
            write(draft)
        figures["seconds"]["write"] = time.perf_counter() - started
        if report_file:
            drafts[-1].write_text(report.as_json(figures), encoding="utf-8")


def _show(figures: dict[str, Any], source: str, notes: list[str]) -> None:
    console = Console()
    console.print(report.table(figures, source))
    for note in dict.fromkeys(notes):
        console.print(f"note: {note}", markup=False, highlight=False)


@contextlib.contextmanager
def _progress_bar() -> Iterator[Callable[[str, float], bool] | None]:
    """A bar on stderr while someone is watching."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def progress(stage: str, fraction: float) -> bool:
            bar.update(task, description=stage, completed=fraction)
            return True

        yield progress
