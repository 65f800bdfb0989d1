"""The work that is measured: volumes, transfer functions, camera and light, stated once for incise and for every peer."""

import gzip
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# As in incise's Camera: a small margin around the volume, a vertical field of view of 30 degrees.
MARGIN = 1.04
FIELD_OF_VIEW_DEG = 30.0
# Largest displacement of the measured field, mm.
FIELD_MM = 8.0

Rgb = tuple[float, float, float]
Point = tuple[float, Rgb, float]

BONE_DARK, BONE, WHITE = (0.77, 0.63, 0.46), (0.94, 0.89, 0.79), (1.0, 1.0, 1.0)
MUSCLE, SKIN = (0.69, 0.3, 0.26), (0.87, 0.69, 0.59)

# Value, colour, opacity over one voxel. "surface" ends most rays within a few voxels of a surface,
# "soft" ends few of them.
TRANSFER: dict[str, list[Point]] = {
    "ct-surface": [(150, BONE_DARK, 0.0), (220, BONE_DARK, 0.25), (450, BONE, 0.75), (1200, WHITE, 0.95), (1900, WHITE, 0.95)],
    "ct-soft": [(-150, SKIN, 0.0), (-20, SKIN, 0.01), (40, MUSCLE, 0.012), (130, MUSCLE, 0.016), (300, BONE_DARK, 0.03), (1200, BONE, 0.06), (1900, WHITE, 0.06)],
    "mr-surface": [(30, SKIN, 0.0), (60, SKIN, 0.5), (100, SKIN, 0.9), (254, BONE, 0.95)],
    "mr-soft": [(20, MUSCLE, 0.0), (60, MUSCLE, 0.006), (110, SKIN, 0.014), (180, BONE, 0.022), (254, WHITE, 0.03)],
}


@dataclass(frozen=True)
class Light:
    """A headlight."""

    ambient: float
    diffuse: float
    specular: float
    shininess: float


HEADLIGHT = Light(0.25, 0.7, 0.1, 20.0)
# Shown in white: opacity alone, on which programs with different lighting models must agree.
FLAT = Light(1.0, 0.0, 0.0, 20.0)


@dataclass(frozen=True)
class Case:
    """One picture."""

    name: str
    volume: str
    transfer: str
    view: tuple[float, float] = (40.0, 20.0)
    size: int = 512
    light: Light = HEADLIGHT
    step: float = 1.0
    """In voxels."""
    voxels: int = 1
    """Over how many voxels the opacities hold."""

    def points(self) -> list[Point]:
        """The transfer function, opacities over one voxel."""
        points = [(value, color, 1.0 - (1.0 - opacity) ** (1.0 / self.voxels)) for value, color, opacity in TRANSFER[self.transfer]]
        return [(value, WHITE, opacity) for value, _, opacity in points] if self.light is FLAT else points


def scene_toml(case: Case, azimuth_deg: float, mode: str = "raycast", deformation: str = "") -> str:
    """The case as incise's scene; `azimuth_deg` is added to the view. The worker puts the loaded volume in."""
    points = ",\n".join(f"  {{ value = {v:.1f}, color = [{r}, {g}, {b}], opacity = {a:.6g} }}" for v, (r, g, b), a in case.points())
    return f"""incise = 1

[volume]
path = "{case.volume}"

[transfer]
points = [
{points},
]

[camera]
view = "{case.view[0] + azimuth_deg:.4f},{case.view[1]}"

[light]
ambient = {case.light.ambient}
diffuse = {case.light.diffuse}
specular = {case.light.specular}
shininess = {case.light.shininess}
direction = [0.0, 0.0, 1.0]
follows_camera = true
two_sided = true

[render]
mode = "{mode}"
size = [{case.size}, {case.size}]
step = {case.step}
background = [0.0, 0.0, 0.0, 1.0]

{deformation}"""


@dataclass(frozen=True)
class Eye:
    """A camera in world space, as incise's ViewFrame."""

    position: np.ndarray
    target: np.ndarray
    up: np.ndarray


def eye(low: np.ndarray, high: np.ndarray, view: tuple[float, float]) -> Eye:
    """incise's camera for a box: at zoom 1 the box just fits a square picture."""
    azimuth, elevation = (math.radians(v) for v in view)
    forward = -np.array([math.sin(azimuth) * math.cos(elevation), -math.cos(azimuth) * math.cos(elevation), math.sin(elevation)])
    up = np.array([-math.sin(azimuth) * math.sin(elevation), math.cos(azimuth) * math.sin(elevation), math.cos(elevation)])
    right = np.cross(forward, up)
    center = (low + high) / 2
    tan = math.tan(math.radians(FIELD_OF_VIEW_DEG) / 2)
    away = 0.0
    for corner in np.array(np.meshgrid(*zip(low, high))).T.reshape(-1, 3) - center:
        x, y, z = abs(corner @ right) * MARGIN, abs(corner @ up) * MARGIN, corner @ forward
        away = max(away, y / tan - z, x / tan - z)
    return Eye(center - forward * away, center, up)


@dataclass(frozen=True)
class Volume:
    """A volume along the world's axes (LPS): `voxels[k, j, i]`."""

    voxels: np.ndarray
    spacing: np.ndarray
    origin: np.ndarray

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the outermost voxels' outer faces, mm."""
        size = np.array(self.voxels.shape[::-1])
        low = self.origin - self.spacing / 2
        return low, low + self.spacing * size


def read_volume(path: Path) -> Volume:
    """Reads a NIfTI file whose axes lie along the world's, and turns them to LPS."""
    data = (gzip.open if path.suffix == ".gz" else open)(path, "rb").read()
    size = np.frombuffer(data, "<i2", 3, 42)
    kind = {2: "u1", 4: "<i2", 16: "<f4"}[int(np.frombuffer(data, "<i2", 1, 70)[0])]
    start = int(np.frombuffer(data, "<f4", 1, 108)[0])
    rows = np.frombuffer(data, "<f4", 12, 280).reshape(3, 4).astype(np.float64)
    voxels = np.frombuffer(data, kind, int(np.prod(size, dtype=np.int64)), start).reshape(size[::-1])
    # The file is RAS.
    steps, origin = np.diag(rows[:, :3]) * (-1, -1, 1), rows[:, 3] * (-1, -1, 1)
    if np.abs(rows[:, :3]).sum() > np.abs(steps).sum() * 1.0001:
        raise ValueError(f"{path.name}: its axes are not the world's")
    for axis in range(3):
        if steps[axis] < 0:
            voxels = np.flip(voxels, 2 - axis)
            origin[axis] += steps[axis] * (size[axis] - 1)
    return Volume(np.ascontiguousarray(voxels), np.abs(steps), origin)


@dataclass(frozen=True)
class Field:
    """A displacement field on a grid along the world's axes: `vectors[k, j, i]` = source minus deformed point, mm, LPS."""

    vectors: np.ndarray
    spacing: np.ndarray
    origin: np.ndarray

    def write(self, path: Path) -> None:
        """Writes a MetaImage, which every toolkit reads."""
        numbers = {"Offset": self.origin, "ElementSpacing": self.spacing, "DimSize": self.vectors.shape[2::-1]}
        lines = ["ObjectType = Image", "NDims = 3", "BinaryData = True", "BinaryDataByteOrderMSB = False", "TransformMatrix = 1 0 0 0 1 0 0 0 1"]
        lines += [f"{name} = {' '.join(repr(v.item()) if isinstance(v, np.generic) else repr(v) for v in values)}" for name, values in numbers.items()]
        lines += ["ElementNumberOfChannels = 3", "ElementType = MET_FLOAT", "ElementDataFile = LOCAL", ""]
        path.write_bytes("\n".join(lines).encode() + self.vectors.astype("<f4").tobytes())


def smooth_field(volume: Volume, points: int) -> Field:
    """A smooth, invertible field over the whole volume that vanishes on its faces."""
    low, high = volume.box()
    axis = np.linspace(0.0, 1.0, points)
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    window = (np.sin(np.pi * x) * np.sin(np.pi * y) * np.sin(np.pi * z)) ** 2
    waves = np.stack([np.sin(2 * np.pi * y), np.sin(2 * np.pi * z), np.sin(2 * np.pi * x)], axis=-1)
    return Field((FIELD_MM * window[..., None] * waves).astype(np.float32), (high - low) / (points - 1), low)
