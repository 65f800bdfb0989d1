"""Measures incise and its peers alternately in one run on the same work; see README.md. Run it by run.sh."""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import work

ROOT = Path(__file__).resolve().parents[2]
HEAD = ROOT / "volumes" / "colin27-head-t1.nii.gz"
# Tolerance of the mean brightness between two pictures, as a fraction: programs step differently
# through the outermost voxels.
AGREEMENT = 0.04
# Tolerance of baked values, which may be rounded or truncated.
BAKED = 1.0
# Allowed peak memory of a picture: this factor times the bytes of the voxels, plus this constant.
MEMORY_FACTOR, MEMORY_BASE = 2.2, 200e6
# A slow alternative is repeated until this much time is spent, s, but at least this many times.
LONGEST, FEWEST = 240.0, 3

SURFACE = work.Case("CT, surface", "ct", "ct-surface")
SOFT = work.Case("CT, soft", "ct", "ct-soft")
CASES = [SURFACE, SOFT, work.Case("head MR, surface", "mr", "mr-surface"), work.Case("head MR, soft", "mr", "mr-soft")]
FIELD = '[[deformation]]\nkind = "field"\npath = "{path}"\nprogress = {strength}\n'
# A box with a third of the volume of the phantom's 160 mm box.
THIRD = 'center = [0.0, 0.0, 24.5]\nsize = [111.0, 111.0, 111.0]\nresolution = 64\n'
TWIST = f'[[deformation]]\nkind = "twist"\n{THIRD}'
KNIFE = f'[[deformation]]\nkind = "knife"\n{THIRD}'

Way = Callable[[int], float]


class Missing(Exception):
    """Something that cannot be measured here, and why."""


@dataclass
class Row:
    """One comparison. `ratio` is against's time over incise's, or incise's over against's where `slower` is asked."""

    line: int
    work: str
    incise: list[float]
    against: str
    other: list[float]
    slower: bool = False
    bar: float | None = None
    unit: str = "ms"
    note: str = ""

    def ratios(self) -> list[float]:
        """Round by round, since both ran in turn; at least the medians' where the counts differ."""
        pairs = zip(self.other, self.incise) if len(self.other) == len(self.incise) else [(statistics.median(self.other), statistics.median(self.incise))]
        return [i / o if self.slower else o / i for o, i in pairs]

    def passed(self) -> bool | None:
        """Whether the bar is met, if there is one."""
        if self.bar is None:
            return None
        ratio = statistics.median(self.ratios())
        return ratio <= self.bar if self.slower else ratio >= self.bar


@dataclass
class Report:
    """What a run has found."""

    machine: dict[str, Any] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """Says something now and keeps it."""
        print(f"  {text}", flush=True)
        self.notes.append(text)


def quartiles(times: list[float]) -> tuple[float, float, float]:
    """First quartile, median, third quartile."""
    q1, q2, q3 = np.percentile(times, [25, 50, 75])
    return float(q1), float(q2), float(q3)


def spread(times: list[float], digits: int) -> str:
    """Median and quartiles."""
    q1, q2, q3 = quartiles(times)
    return f"{q2:.{digits}f} [{q1:.{digits}f}, {q3:.{digits}f}]"


class Worker:
    """incise, held open."""

    def __init__(self, program: Path, threads: int) -> None:
        environment = os.environ | {"RAYON_NUM_THREADS": str(threads)}
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)

    def ask(self, **request: Any) -> dict[str, Any]:
        """One request, one answer."""
        assert self.process.stdin and self.process.stdout
        try:
            print(json.dumps(request), file=self.process.stdin, flush=True)
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise Missing(f"incise's worker ended at {request['do']}")
        answer = json.loads(line)
        if "error" in answer:
            raise Missing(f"incise: {answer['error']}")
        return answer


class Bench:
    """Everything that the lines share."""

    def __init__(self, arguments: argparse.Namespace, folder: Path) -> None:
        self.worker = Worker(arguments.worker, arguments.threads)
        self.about = self.worker.ask(do="about")
        built = Path(self.about.pop("program"))
        self.incise = arguments.incise or built
        self.threads, self.repeats, self.folder = arguments.threads, arguments.repeats, folder
        self.pictures: Path = arguments.pictures
        self.report = Report()
        self.volumes: dict[str, work.Volume] = {}
        self.loaded: set[str] = set()

    def phantom(self, size: int) -> Path:
        """The CT phantom as a file, made once."""
        path = self.folder / f"head-ct-{size}.nii"
        if not path.exists():
            subprocess.run([self.incise, "bake", "--quiet", f"phantom:head-ct:size={size}", "-o", path], check=True)
        return path

    def path(self, name: str) -> Path:
        """The file of a volume: `mr`, `ct`, or `ct` with a size."""
        return HEAD if name == "mr" else self.phantom(int(name[2:] or 256))

    def load(self, name: str) -> None:
        """Loads a volume into incise."""
        if name not in self.loaded:
            self.worker.ask(do="load", name=name, path=str(self.path(name)))
            self.loaded.add(name)

    def forget(self, name: str) -> None:
        """Makes room."""
        self.worker.ask(do="forget", name=name)
        self.loaded.discard(name)

    def volume(self, name: str) -> work.Volume:
        """The same volume for the peers."""
        if name not in self.volumes:
            self.volumes[name] = work.read_volume(self.path(name))
        return self.volumes[name]

    def field_file(self, points: int) -> tuple[work.Field, Path]:
        """The field over the CT phantom, and its file."""
        made = work.smooth_field(self.volume("ct"), points)
        path = self.folder / f"field-{points}.mha"
        made.write(path)
        return made, path

    def vtk(self) -> Any:
        """VTK, if there is one."""
        try:
            import vtk_peer
        except ImportError as error:
            raise Missing(f"VTK: {error}") from error
        vtk_peer.use_threads(self.threads)
        return vtk_peer

    def itk(self) -> Any:
        """SimpleITK, if there is one."""
        try:
            import itk_peer
        except ImportError as error:
            raise Missing(f"SimpleITK: {error}") from error
        itk_peer.use_threads(self.threads)
        return itk_peer

    def scipy(self) -> Any:
        """SciPy, if there is one."""
        try:
            import scipy_peer
        except ImportError as error:
            raise Missing(f"SciPy: {error}") from error
        return scipy_peer

    def alternate(self, ways: dict[str, Way]) -> dict[str, list[float]]:
        """Runs the ways in turn, each round beginning with the next one; the first round only warms up. A way that fails is left out."""
        times: dict[str, list[float]] = {name: [] for name in ways}
        names, start = list(ways), time.monotonic()
        for turn in range(self.repeats + 1):
            if turn > FEWEST and time.monotonic() - start > LONGEST:
                break
            for name in names[turn % len(names) :] + names[: turn % len(names)]:
                try:
                    ms = ways[name](turn)
                except (Missing, RuntimeError) as problem:
                    self.report.note(f"left out: {name}: {problem}")
                    times.pop(name)
                    continue
                if turn > 0:
                    times[name].append(ms)
            names = [n for n in names if n in times]
            if not names:
                break
        return times

    def add(self, row: Row) -> None:
        """Keeps a row and shows it."""
        self.report.rows.append(row)
        print(line_of(row), flush=True)

    def compare(self, line: int, work_name: str, times: dict[str, list[float]], ours: list[str], bars: dict[str, float | None]) -> None:
        """Rows of each of incise's ways against each peer of `bars`."""
        for mine in ours:
            for peer, bar in bars.items():
                if times.get(mine) and times.get(peer):
                    self.add(Row(line, f"{work_name}: {mine}", times[mine], peer, times[peer], bar=bar))

    def ray(self, case: work.Case, backend: str, mode: str = "raycast", deformation: str = "") -> Way:
        """One frame of incise after the camera moved."""
        self.load(case.volume)

        def way(turn: int) -> float:
            scene = work.scene_toml(case, 0.001 * turn, mode, deformation)
            return float(self.worker.ask(do="render", volume=case.volume, backend=backend, scene=scene)["ms"])

        return way

    @staticmethod
    def steady(way: Way) -> Way:
        """What comes first after another volume or size brings the volume to the adapter and its differences to memory: not timed."""

        def second(turn: int) -> float:
            way(turn)
            return way(turn)

        return second

    def picture(self, case: work.Case, backend: str, mode: str) -> np.ndarray:
        """A picture of incise: 8-bit RGB."""
        self.load(case.volume)
        path = self.folder / "picture.rgba"
        self.worker.ask(do="render", volume=case.volume, backend=backend, scene=work.scene_toml(case, 0.0, mode), picture=str(path))
        return np.fromfile(path, np.uint8).reshape(case.size, case.size, 4)[..., :3]

    def agree(self, line: int, case: work.Case, backend: str, modes: list[str]) -> None:
        """In flat white all programs show the same opacities; else the comparison is void."""
        vtk = self.vtk()
        for light, name in ((work.FLAT, "flat"), (work.HEADLIGHT, "lit")):
            lit = work.Case(case.name, case.volume, case.transfer, case.view, case.size, light)
            renderer = vtk.Renderer(self.volume(case.volume), lit, backend == "gpu")
            renderer.look(0.0)
            pictures = [self.picture(lit, backend, mode) for mode in modes] + [renderer.picture()]
            if self.pictures:
                self.pictures.mkdir(parents=True, exist_ok=True)
                file = f"{line}-{backend}-{case.name}-{name}.png".replace(", ", "-").replace(" ", "-")
                vtk.write_png(np.hstack(pictures), str(self.pictures / file))
            theirs = pictures[-1]
            for mode, ours in zip(modes, pictures):
                brightness = ours.mean() / theirs.mean()
                covered = [float((p.max(axis=2) > 2).mean()) for p in (ours, theirs)]
                difference = np.abs(ours.astype(float) - theirs).mean() / 255
                verdict = "" if light is work.HEADLIGHT or abs(brightness - 1) <= AGREEMENT else ": THE PICTURES DISAGREE, the comparison is void"
                self.report.note(
                    f"{case.name}, {backend} {mode}, {name}: brightness {brightness:.3f} of VTK's, "
                    f"covered {covered[0]:.3f} against {covered[1]:.3f}, mean difference {difference:.4f}{verdict}"
                )


def timed(action: Callable[[], Any]) -> float:
    """Milliseconds."""
    start = time.perf_counter()
    action()
    return 1e3 * (time.perf_counter() - start)


def vtk_frame(renderer: Any) -> Way:
    """One frame of VTK after the camera moved, read back."""

    def way(turn: int) -> float:
        renderer.look(0.001 * turn)
        return timed(renderer.picture)

    return way


def line_1(bench: Bench) -> None:
    """CPU ray casting, undeformed."""
    vtk = bench.vtk()
    for case in CASES:
        bench.agree(1, case, "cpu", ["raycast"])
        volume = bench.volume(case.volume)
        ways = {
            "incise, CPU": bench.ray(case, "cpu"),
            "VTK FixedPoint": vtk_frame(vtk.Renderer(volume, case, on_gpu=False)),
            "VTK FixedPoint, coarsened": vtk_frame(vtk.Renderer(volume, case, on_gpu=False, best=True)),
        }
        bench.compare(1, case.name, bench.alternate(ways), ["incise, CPU"], {"VTK FixedPoint": 2.0, "VTK FixedPoint, coarsened": None})


def line_2(bench: Bench) -> None:
    """Ray casting and slicing on the same graphics adapter."""
    vtk = bench.vtk()
    for case in CASES:
        bench.agree(2, case, "gpu", ["raycast", "slice"])
        volume = bench.volume(case.volume)
        theirs = vtk.Renderer(volume, case, on_gpu=True)
        ways = {
            "incise, GPU rays": bench.ray(case, "gpu"),
            "incise, GPU slices": bench.ray(case, "gpu", "slice"),
            "VTK GPU": vtk_frame(theirs),
            "VTK GPU, coarsened": vtk_frame(vtk.Renderer(volume, case, on_gpu=True, best=True)),
        }
        times = bench.alternate(ways)
        for ours, bar in (("incise, GPU rays", 3.0), ("incise, GPU slices", 1.5)):
            bench.compare(2, case.name, times, [ours], {"VTK GPU": bar, "VTK GPU, coarsened": None})
        bench.report.machine["VTK's OpenGL"] = theirs.driver()


def line_3(bench: Bench) -> None:
    """A deformation is edited: to the next picture."""
    volume = bench.volume("ct")
    made, path = bench.field_file(64)
    fill = float(volume.voxels.min())
    ways: dict[str, Way] = {}

    def edit(backend: str) -> Way:
        bench.load("ct")

        def way(turn: int) -> float:
            scene = work.scene_toml(SURFACE, 0.0, deformation=FIELD.format(path=path, strength=round(1.0 - 0.02 * turn, 3)))
            return float(bench.worker.ask(do="render", volume="ct", backend=backend, scene=scene)["ms"])

        return way

    def resampled(to_image: Callable[[float], Any], renderer: Any) -> Way:
        renderer.look(0.0)

        def way(turn: int) -> float:
            def work_of_it() -> None:
                renderer.mapper.SetInputData(to_image(1.0 - 0.02 * turn))
                renderer.picture()

            return timed(work_of_it)

        return way

    ours = ["incise, CPU", "incise, GPU rays"]
    ways["incise, CPU"], ways["incise, GPU rays"] = edit("cpu"), edit("gpu")
    vtk = bench.vtk()
    reslice = vtk.Reslice(volume, made, fill)
    mappers = {"FixedPoint": False, "GPU": True}
    for mapper, on_gpu in mappers.items():
        ways[f"vtkImageReslice, {mapper}"] = resampled(reslice.run, vtk.Renderer(volume, SURFACE, on_gpu))
    try:
        itk = bench.itk()
        resample = itk.Resample(volume, made, fill)

        def from_itk(strength: float) -> Any:
            return vtk.image(work.Volume(resample.array(strength), volume.spacing, volume.origin))

        for mapper, on_gpu in mappers.items():
            ways[f"SimpleITK, {mapper}"] = resampled(from_itk, vtk.Renderer(volume, SURFACE, on_gpu))
    except Missing as missing:
        bench.report.note(f"left out: {missing}")
    bars: dict[str, float | None] = {name: 8.0 for name in ways if name not in ours}
    bench.compare(3, "edit of a 64^3 field, CT 256^3", bench.alternate(ways), ours, bars)


def line_4(bench: Bench) -> None:
    """Deformed against undeformed."""
    backends = {"CPU": ("cpu", "raycast"), "GPU rays": ("gpu", "raycast"), "GPU slices": ("gpu", "slice")}
    for case in (SURFACE, SOFT):
        for name, (backend, mode) in backends.items():
            ways = {"undeformed": bench.ray(case, backend, mode), "twist": bench.ray(case, backend, mode, TWIST), "knife": bench.ray(case, backend, mode, KNIFE)}
            times = bench.alternate(ways)
            for kind, what in (("twist", "64^3 map"), ("knife", "64^3 map with a cut")):
                if times.get(kind) and times.get("undeformed"):
                    bench.add(Row(4, f"{case.name}: incise, {name}, {what} over a third", times[kind], "undeformed", times["undeformed"], slower=True, bar=1.5))


def line_5(bench: Bench) -> None:
    """The deformed volume as a volume."""
    volume = bench.volume("ct")
    made, path = bench.field_file(64)
    fill = float(volume.voxels.min())
    bench.load("ct")
    scene = work.scene_toml(SURFACE, 0.0, deformation=FIELD.format(path=path, strength=1.0))
    baked = bench.folder / "baked.nii"
    ways: dict[str, Way] = {"incise": lambda turn: float(bench.worker.ask(do="bake", volume="ct", scene=scene)["ms"])}
    resamplers = {"vtkImageReslice": lambda: bench.vtk().Reslice, "SimpleITK": lambda: bench.itk().Resample, "SciPy map_coordinates": lambda: bench.scipy().Resample}
    bench.worker.ask(do="bake", volume="ct", scene=scene, output=str(baked))
    ours = work.read_volume(baked).voxels.astype(np.float32)[1:-1, 1:-1, 1:-1]
    for name, find in resamplers.items():
        try:
            resampler = find()(volume, made, fill)
        except Missing as missing:
            bench.report.note(f"left out: {missing}")
            continue
        difference = float(np.abs(resampler.array(1.0)[1:-1, 1:-1, 1:-1] - ours).mean())
        verdict = "" if difference <= BAKED else ": THE VOLUMES DISAGREE, the comparison is void"
        bench.report.note(f"{name}: mean difference {difference:.3f} in a volume of {np.ptp(volume.voxels)}{verdict}")
        ways[name] = lambda turn, r=resampler: timed(lambda: r.array(1.0))
    bench.compare(5, "bake 256^3 under a 64^3 field", bench.alternate(ways), ["incise"], {name: 3.0 for name in resamplers})


def line_6(bench: Bench) -> None:
    """The gradient of a volume."""
    bench.load("ct")
    vtk = bench.vtk()
    kept = vtk.gradient(bench.volume("ct"))

    def again(_turn: int) -> float:
        kept.Modified()
        return timed(kept.Update)

    ways: dict[str, Way] = {
        "incise": lambda turn: float(bench.worker.ask(do="gradient", volume="ct")["ms"]),
        "vtkImageGradient": lambda turn: timed(vtk.gradient(bench.volume("ct")).Update),
        "vtkImageGradient, into memory that it has": again,
    }
    bench.compare(6, "gradient of 256^3", bench.alternate(ways), ["incise"], {"vtkImageGradient": 3.0, "vtkImageGradient, into memory that it has": None})


def line_7(bench: Bench) -> None:
    """The inverse of a field."""
    made, path = bench.field_file(128)
    bench.worker.ask(do="load_field", name="field", path=str(path))
    judge = bench.scipy().residual_mm
    output = bench.folder / "inverse.f32"
    bench.worker.ask(do="invert", field="field", output=str(output))
    residuals = {"incise": judge(made, np.fromfile(output, np.float32).reshape(made.vectors.shape).astype(np.float64))}
    inversion = bench.itk().Inversion(made)
    array = bench.itk().array
    # With default settings (more iterations of the second change nothing), and at about the
    # accuracy of incise.
    theirs: dict[str, Callable[[], Any]] = {
        "InvertDisplacementField, 10 iterations": lambda: inversion.direct(10, 0.1),
        "InvertDisplacementField, to 1e-3 voxels": lambda: inversion.direct(200, 1e-3),
        "IterativeInverseDisplacementField, 5 iterations": lambda: inversion.iterative(5),
    }
    ways: dict[str, Way] = {"incise": lambda turn: float(bench.worker.ask(do="invert", field="field")["ms"])}
    for name, invert in theirs.items():
        residuals[name] = judge(made, array(invert()).astype(np.float64))
        ways[name] = lambda turn, i=invert: timed(i)
    for name, (mean, high) in residuals.items():
        better = "".join(f"; {what} more exact than incise" for what, ours, it in zip(("on average", "in its tail"), residuals["incise"], (mean, high)) if it < ours)
        bench.report.note(f"{name}: residual mean {mean:.2e} mm, 99.9 % below {high:.2e} mm{better}")
    bench.compare(7, "inverse of a 128^3 field", bench.alternate(ways), ["incise"], {name: 5.0 for name in theirs})


def line_8(bench: Bench) -> None:
    """How the time of a picture grows with the volume and with the picture."""
    for backend, name in (("cpu", "CPU"), ("gpu", "GPU rays")):
        for transfer in ("ct-surface", "ct-soft"):
            # The same opacity per millimetre: a voxel is a quarter as long.
            small, large = work.Case(transfer, "ct128", transfer), work.Case(transfer, "ct512", transfer, voxels=4)
            ways = {"128^3": small, "a sample a voxel": large, "the same samples": replace(large, step=4.0)}
            times = bench.alternate({way: bench.steady(bench.ray(case, backend)) for way, case in ways.items()})
            for way in list(ways)[1:]:
                if times.get(way) and times.get("128^3"):
                    what = f"{transfer}: incise, {name}, 512^3 volume, {way}"
                    bench.add(Row(8, what, times[way], "128^3 volume", times["128^3"], slower=True, bar=3.0))
            wide = work.Case(transfer, "ct", transfer, size=1024)
            ways = {"512": work.Case(transfer, "ct", transfer), "1024": wide}
            times = bench.alternate({way: bench.steady(bench.ray(case, backend)) for way, case in ways.items()})
            if times.get("1024") and times.get("512"):
                bench.add(Row(8, f"{transfer}: incise, {name}, 1024 x 1024", times["1024"], "512 x 512", times["512"], slower=True, bar=4.2))
    bench.forget("ct128")
    bench.forget("ct512")


def line_9(bench: Bench) -> None:
    """incise as a program: memory, and the first picture."""
    output, stats = bench.folder / "picture.png", bench.folder / "stats.json"

    def run(volume: Path) -> tuple[float, dict[str, Any]]:
        command = [bench.incise, "render", "--quiet", volume, "-o", output, "--backend", "cpu", "--threads", str(bench.threads), "--stats", stats]
        ms = timed(lambda: subprocess.run(command, check=True))
        return ms, json.loads(stats.read_text())

    for size in (256, 512):
        path = bench.phantom(size)
        most = MEMORY_FACTOR * size**3 * 2 + MEMORY_BASE
        # The program's own VmHWM: the peak that a parent sees for its child includes the parent's
        # size at the fork.
        peaks = [run(path)[1]["peak_memory_bytes"] for _ in range(FEWEST)]
        bench.add(Row(9, f"peak memory of incise render, CT {size}^3", [p / 1e6 for p in peaks], "allowed", [most / 1e6] * len(peaks), bar=1.0, unit="MB"))
    runs = [run(HEAD) for _ in range(bench.repeats + 1)][1:]
    stages = {name: statistics.median(s["milliseconds"].get(name, 0.0) for _, s in runs) for name in runs[0][1]["milliseconds"]}
    bench.report.note(f"first picture of the head from the process's start: {spread([ms for ms, _ in runs], 0)} ms")
    bench.report.note("of which, ms: " + ", ".join(f"{name} {ms:.1f}" for name, ms in stages.items()))


LINES: dict[int, Callable[[Bench], None]] = {1: line_1, 2: line_2, 3: line_3, 4: line_4, 5: line_5, 6: line_6, 7: line_7, 8: line_8, 9: line_9}


def line_of(row: Row) -> str:
    """A row for people."""
    verdict = {None: "", True: "met", False: "MISSED"}[row.passed()]
    bar = "" if row.bar is None else f"{'<=' if row.slower else '>='} {row.bar:g} {verdict}"
    digits = 0 if row.unit == "MB" else 1
    return f"| {row.line} | {row.work} | {spread(row.incise, digits)} | {row.against} | {spread(row.other, digits)} | {spread(row.ratios(), 2)} | {bar} |"


HEADER = "| line | work | incise, ms (or MB) | against | ms (or MB) | ratio | bar |\n|---|---|---|---|---|---|---|"


def as_json(row: Row) -> dict[str, Any]:
    """A row for programs."""
    return asdict(row) | {"incise_quartiles": quartiles(row.incise), "other_quartiles": quartiles(row.other), "ratio_quartiles": quartiles(row.ratios()), "passed": row.passed()}


def versions() -> dict[str, str]:
    """Of the peers that are there."""
    found = {}
    for name in ("vtk_peer", "itk_peer", "scipy_peer"):
        try:
            found[name] = __import__(name).version()
        except ImportError as error:
            found[name] = f"missing: {error}"
    return found


def main() -> int:
    """Runs the lines that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worker", type=Path, required=True, help="the bench program `peers`")
    parser.add_argument("--incise", type=Path, help="the program, instead of the one built with the worker")
    parser.add_argument("--only", default=",".join(map(str, LINES)), help="lines, as 1,3")
    parser.add_argument("--repeats", type=int, default=7, help="rounds after the one that warms up")
    parser.add_argument("--quick", action="store_true", help="three rounds")
    parser.add_argument("--threads", type=int, default=2, help="of every program")
    parser.add_argument("--json", type=Path, default=ROOT / "target" / "peers" / "results.json", help="where the numbers go")
    parser.add_argument("--pictures", type=Path, default=ROOT / "target" / "peers" / "pictures", help="where pictures side by side go")
    arguments = parser.parse_args()
    arguments.repeats = FEWEST if arguments.quick else arguments.repeats
    os.environ["LP_NUM_THREADS"] = str(arguments.threads)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(arguments, Path(folder))
        machine = {"cpu": platform.processor() or platform.machine(), "cores": os.cpu_count(), "load before": os.getloadavg(), "python": sys.version.split()[0]}
        bench.report.machine = machine | {"incise": bench.about, "peers": versions()}
        for number in map(int, arguments.only.split(",")):
            print(f"\n{LINES[number].__doc__}", flush=True)
            try:
                LINES[number](bench)
            except Missing as missing:
                bench.report.note(f"line {number} is left out: {missing}")
        bench.report.machine["load after"] = os.getloadavg()
    report = bench.report
    print("\n" + HEADER)
    print("\n".join(map(line_of, report.rows)))
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps({"machine": report.machine, "rows": [as_json(r) for r in report.rows], "notes": report.notes}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
