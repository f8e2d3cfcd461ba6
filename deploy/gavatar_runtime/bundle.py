"""The avatar bundle `NAME.gavatar`: all that playing an avatar needs, in one zip that also works unpacked.

| member | holds |
|---|---|
| manifest.json | `Manifest`: what the avatar is, where it came from, SHA-256 of every other member |
| surface.npz | the places of the Gaussians, and of the encoder's positional map: `pack_surfaces` |
| body.npz | skeleton and shape for viewers: joint_names, parents, joints, betas: `pack_body` |
| decoder.onnx | -> offsets (N, 3), colors (N, 3), scales (N,); no input, or if dynamic: pose_features (1, C, M, M) |
| | and, optional, rows (M,) int32: then only those Gaussians are decoded, in that order |
| encoder.onnx | dynamic avatars only: any of `pose_inputs.INPUTS` -> pose_features (1, C, M, M) |

Further members (cheaper tiers) may stand beside these; they are listed and checked the same way. No member holds
pickled objects, and nothing is ever unpacked to disk.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .errors import MissingFile, UserError, cannot_read
from .formats.bounded import arrays_of_npz, read_zipped
from .formats.files import atomic
from .geometry.grid_spacing import spacing_on_grid
from .geometry.ordering import progressive_rank
from .values.array_rules import FAR, Rule, checked
from .values.body import Hands
from .values.surface import ATLAS_RULES, SURFACE_RULES, Atlas, Surface
from .version import __version__

FORMAT = "gavatar"
FORMAT_VERSION = 2  # 1: the Gaussians are texels of an atlas
MANIFEST = "manifest.json"
SURFACE, BODY, DECODER, ENCODER = "surface.npz", "body.npz", "decoder.onnx", "encoder.onnx"
ALWAYS, DYNAMIC = (SURFACE, BODY, DECODER), (ENCODER,)
UNITS = {"length": "metres", "angle": "radians", "color": "sRGB in [0, 1]", "up": "y"}
_MEMBER_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)  # the same bytes whenever the same avatar is written


@dataclasses.dataclass(frozen=True)
class Manifest:
    """What a bundle says of itself.

    name: the avatar's. gaussians: N. dynamic: whether the look depends on the pose, so that encoder.onnx is there.
    body: at least `model` (the body component) and `joints` (J). components: registry names of encoder and decoder, and
    `encoder_inputs`. opset: of the ONNX members. license: of the avatar, as the capture states it. training: a summary
    (capture, losses, steps, metrics). rasterizer: options that change the picture, which the avatar was trained with
    and is played with therefore. export_check: the exported model's errors against the one that was trained, with their
    units. tiers: descriptions of cheaper members with their measured error and cost. members: SHA-256 by file name,
    filled by `write_bundle`. extra: fields of the same format version that this program does not know; they survive a
    rewrite.
    """

    name: str
    gaussians: int
    dynamic: bool
    body: dict[str, Any]
    components: dict[str, Any]
    opset: int
    license: str = ""
    training: dict[str, Any] = dataclasses.field(default_factory=dict)
    rasterizer: dict[str, Any] = dataclasses.field(default_factory=dict)
    export_check: dict[str, Any] = dataclasses.field(default_factory=dict)
    tiers: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    units: dict[str, str] = dataclasses.field(default_factory=lambda: dict(UNITS))
    created_by: str = f"gavatar {__version__}"
    members: dict[str, str] = dataclasses.field(default_factory=dict)
    extra: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def required(self) -> tuple[str, ...]:
        """Members without which the avatar cannot play."""
        return ALWAYS + (DYNAMIC if self.dynamic else ())

    def to_json(self) -> dict[str, Any]:
        """Plain values, the format first."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "extra"}
        return {"format": FORMAT, "format_version": FORMAT_VERSION, **values, **self.extra}

    @classmethod
    def from_json(cls, values: Any, source: str) -> Manifest:
        """The manifest in parsed JSON; UserError naming `source` if it is not one, is of a later format version, lacks
        a field or has one of the wrong kind."""
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise UserError(f"{source} is not a gavatar bundle: its {MANIFEST} does not say format '{FORMAT}'")
        version = values.get("format_version")
        if type(version) is not int or version < 1:
            raise UserError(f"{source}: {MANIFEST} has format_version {version!r}, expected a whole number")
        if version > FORMAT_VERSION:
            raise UserError(
                f"{source} has bundle format {version}, and this gavatar {__version__} reads up to {FORMAT_VERSION}: "
                f"update gavatar (it was written by {values.get('created_by', 'a later version')})"
            )
        known = {}
        for field in dataclasses.fields(cls):
            kind = _KINDS[field.name]
            if field.name == "extra":
                continue
            if field.name in values:
                if type(values[field.name]) is not kind:
                    found = type(values[field.name]).__name__
                    raise UserError(f"{source}: {MANIFEST} field '{field.name}' is a {found}, expected {kind.__name__}")
                known[field.name] = values[field.name]
            elif field.name in _NEEDED:
                raise UserError(f"{source}: {MANIFEST} lacks the field '{field.name}'; export the avatar again")
        extra = {k: v for k, v in values.items() if k not in known and k not in ("format", "format_version")}
        return cls(**known, extra=extra)


_KINDS = {
    "name": str, "gaussians": int, "dynamic": bool, "body": dict, "components": dict, "opset": int, "license": str,
    "training": dict, "rasterizer": dict, "export_check": dict, "tiers": list, "units": dict, "created_by": str,
    "members": dict, "extra": dict,
}  # fmt: skip
_NEEDED = ("name", "gaussians", "dynamic", "body", "components", "opset", "members")


class Bundle:
    """An opened bundle. manifest: `Manifest`. path: where it was read. Members are read and verified when asked for."""

    def __init__(self, path: Path, manifest: Manifest):
        self.path = path
        self.manifest = manifest

    def read(self, member: str) -> bytes:
        """The bytes of a member listed in the manifest; UserError if it is not there, damaged or altered."""
        digest = self.manifest.members.get(member)
        if digest is None:
            raise UserError(f"{self.path} has no member '{member}' in its {MANIFEST}; export the avatar again")
        data = _read_member(self.path, member)
        if hashlib.sha256(data).hexdigest() != digest:
            raise UserError(
                f"{self.path}: {member} does not match its SHA-256 in {MANIFEST}: the bundle is damaged or was altered "
                "by hand; export or download it again"
            )
        return data

    def arrays(self, member: str) -> dict[str, np.ndarray]:
        """The arrays of an .npz member by name, pickles refused."""
        data = self.read(member)
        try:
            return arrays_of_npz(data)
        except Exception as error:  # of bytes that mean anything, `zipfile` and NumPy raise of every kind
            cause = next(iter(str(error).splitlines()), type(error).__name__)
            raise UserError(
                f"{self.path}: {member} is not a readable .npz ({cause}); export the avatar again"
            ) from error

    def surfaces(self) -> tuple[Surface, Atlas | None]:
        """Where the Gaussians sit, and the surface of the encoder's positional map (None for a static avatar).

        What playing does not need is not stored: there `face` is -1 and `barycentric` NaN; so are the `normals` of a
        map whose encoder does not look at them, and of bundles written without them. A map has neither spacing (NaN)
        nor rank (-1).
        """
        arrays, source = self.arrays(SURFACE), f"{self.path}: {SURFACE}"
        gaussians = _unpack_points(arrays, "gaussians_", source)
        encoder_map = _unpack_grid(arrays, "map_", source) if self.manifest.dynamic else None
        if len(gaussians) != self.manifest.gaussians:
            raise UserError(
                f"{source} holds {len(gaussians)} points and {MANIFEST} says {self.manifest.gaussians} Gaussians; "
                "export the avatar again"
            )
        return gaussians, encoder_map


def read_bundle(path: str | os.PathLike, *, verify: bool = False) -> Bundle:
    """Open a bundle, zipped or unpacked, and check that what playing needs is listed and there.

    verify: also read every member and check it against its SHA-256 (otherwise done when a member is read). Raises
    UserError for a path that does not exist or is no bundle, a damaged zip, a missing member and a later format.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFile(f"avatar {path} does not exist")
    try:
        values = json.loads(_read_member(path, MANIFEST).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: {MANIFEST} is not JSON; export the avatar again") from error
    manifest = Manifest.from_json(values, str(path))
    present = _member_names(path)
    for member in (*manifest.required, *manifest.members):
        if member not in manifest.members or member not in present:
            raise UserError(f"{path}: member {member} is missing; export or download the avatar again")
    bundle = Bundle(path, manifest)
    if verify:
        for member in manifest.members:
            bundle.read(member)
    return bundle


def write_bundle(path: str | os.PathLike, manifest: Manifest, members: Mapping[str, bytes]) -> Manifest:
    """Write a bundle, whole or not at all; the same manifest and members give the same file, byte for byte.

    members: contents by file name, all but manifest.json. Returns the manifest as written, with its SHA-256 sums.
    Raises UserError for a place that cannot be written, ValueError for members that make no bundle.
    """
    missing = [name for name in manifest.required if name not in members]
    if missing:
        raise ValueError(f"bundle '{manifest.name}' lacks {', '.join(missing)}")
    for name in members:
        if name == MANIFEST or not _MEMBER_NAME.fullmatch(name):
            raise ValueError(f"'{name}' cannot be a bundle member: plain file names only, and not {MANIFEST}")
    sums = {name: hashlib.sha256(members[name]).hexdigest() for name in sorted(members)}
    manifest = dataclasses.replace(manifest, members=sums)
    text = json.dumps(manifest.to_json(), indent=1, allow_nan=False) + "\n"
    with atomic(path) as temporary, zipfile.ZipFile(temporary, "w") as file:
        _write_member(file, MANIFEST, text.encode("utf-8"))
        for name in sums:
            _write_member(file, name, members[name])
    return manifest


def pack_surfaces(gaussians: Surface, encoder_map: Atlas | None = None, map_normals: bool = False) -> bytes:
    """surface.npz: arrays `gaussians_*` and, for a dynamic avatar, `map_*`, of what playing needs of each surface
    (see `Surface`): points, joint_index, joint_weight, joints, parents, A_canonical; of the Gaussians also uv, spacing
    and rank, and normals as float16 where they are known; of the map also resolution and texel. map_normals: those of
    the map too, for an encoder that looks at them."""
    arrays = _pack_surface(gaussians, "gaussians_", _OF_GAUSSIANS)
    if np.isfinite(gaussians.normals).all():
        arrays["gaussians_normals"] = gaussians.normals.astype(np.float16)
    if encoder_map is not None:
        arrays |= _pack_surface(encoder_map, "map_", _OF_GRID)
        if map_normals:
            arrays["map_normals"] = np.asarray(encoder_map.normals, np.float32)
    return pack_arrays(arrays)


def pack_body(
    joint_names: Sequence[str],
    parents: np.ndarray,
    joints: np.ndarray,
    betas: np.ndarray | None = None,
    rest_pose: np.ndarray | None = None,
    hands: Hands | None = None,
) -> bytes:
    """body.npz: joint_names (J,), parents (J,), joints (J, 3) rest joints of the trained shape, metres, betas (B,), and
    rest_pose (J, 3), axis-angle of joints that no motion moves, unless it is zero; hands_mean (2, 15, 3) and
    hands_components (2, K, 45) where the body has any, for motions that give hands by coefficients."""
    arrays = {
        "joint_names": np.asarray(joint_names, np.str_),
        "parents": np.asarray(parents, np.int32),
        "joints": np.asarray(joints, np.float64),
        "betas": np.zeros(0) if betas is None else np.asarray(betas, np.float64).reshape(-1),
    }
    if rest_pose is not None and np.any(rest_pose):
        arrays["rest_pose"] = np.asarray(rest_pose, np.float64)
    if hands is not None and hands.components.shape[1]:
        arrays["hands_mean"] = np.asarray(hands.mean, np.float32)
        arrays["hands_components"] = np.asarray(hands.components, np.float32)
    return pack_arrays(arrays)


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """An .npz as bytes, the same for the same arrays; pickles refused."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, array in arrays.items():
            data = io.BytesIO()
            np.lib.format.write_array(data, np.asarray(array, order="C"), allow_pickle=False)
            _write_member(file, f"{name}.npy", data.getvalue())
    return buffer.getvalue()


_PACKED = ("points", "joint_index", "joint_weight", "joints", "parents", "A_canonical")
_OF_GAUSSIANS, _OF_GRID = ("uv", "spacing", "rank"), ("resolution", "texel")


def _pack_surface(surface: Surface, prefix: str, more: Sequence[str]) -> dict[str, np.ndarray]:
    arrays = {name: np.asarray(getattr(surface, name)) for name in (*more, *_PACKED)}
    if surface.num_joints <= 256:
        arrays["joint_index"] = arrays["joint_index"].astype(np.uint8)
    return {prefix + name: array for name, array in arrays.items()}


_NORMALS = Rule(("N", 3), low=-2, high=2, optional=True)
_POINT_RULES = {name: rule for name, rule in SURFACE_RULES.items() if name in (*_OF_GAUSSIANS, *_PACKED)} | {
    "rank": dataclasses.replace(SURFACE_RULES["rank"], optional=False),
    "spacing": Rule(("N",), low=0, high=FAR),
    "normals": _NORMALS,
}
_GRID_RULES = {name: rule for name, rule in ATLAS_RULES.items() if name in (*_OF_GRID, *_PACKED)} | {
    "normals": _NORMALS
}


def _unpack_points(arrays: Mapping[str, np.ndarray], prefix: str, source: str) -> Surface:
    """The Gaussians' places. In a bundle of format 1 they are texels, whose spacing and order follow from these."""
    if prefix + "texel" in arrays:
        grid = _unpack_grid(arrays, prefix, source)
        spacing = spacing_on_grid(grid.points, grid.texel, grid.resolution)
        return dataclasses.replace(grid, rank=progressive_rank(grid.points), spacing=spacing)
    known = checked(arrays, _POINT_RULES, source, prefix=prefix)
    return Surface(**{**_left_out(len(known["points"])), **known})


def _unpack_grid(arrays: Mapping[str, np.ndarray], prefix: str, source: str) -> Atlas:
    known = checked(arrays, _GRID_RULES, source, prefix=prefix)
    texel, side = known["texel"], int(known["resolution"])
    uv = ((np.stack([texel % side, texel // side], -1) + 0.5) / side).astype(np.float32)
    absent: dict[str, Any] = {
        "spacing": np.full(len(texel), np.nan, np.float32),
        "rank": np.full(len(texel), -1, np.int32),
    }
    return Atlas(**{**_left_out(len(texel)), **absent, **known, "uv": uv, "resolution": side})


def _left_out(count: int) -> dict[str, Any]:
    nan = np.full((count, 3), np.nan, np.float32)
    return {"face": np.full(count, -1, np.int32), "barycentric": nan, "normals": nan}


def _write_member(file: zipfile.ZipFile, name: str, data: bytes) -> None:
    info = zipfile.ZipInfo(name, _ZIP_TIME)
    # network weights do not shrink, and the .npy files of an .npz are compressed with it
    info.compress_type = zipfile.ZIP_STORED if name.endswith((".onnx", ".npy")) else zipfile.ZIP_DEFLATED
    info.create_system = 3  # Unix, wherever it is written
    info.external_attr = 0o644 << 16
    file.writestr(info, data)


def _member_names(path: Path) -> set[str]:
    if path.is_dir():
        return {entry.name for entry in path.iterdir() if entry.is_file()}
    with _open_zip(path) as file:
        return set(file.namelist())


def _read_member(path: Path, member: str) -> bytes:
    if not _MEMBER_NAME.fullmatch(member):
        raise UserError(f"{path}: '{member}' is not a plain file name; the bundle was altered by hand")
    try:
        if path.is_dir():
            return (path / member).read_bytes()
        with _open_zip(path) as file:
            return read_zipped(file, member)
    except (KeyError, FileNotFoundError):
        if member == MANIFEST:
            raise UserError(f"{path} is not a gavatar bundle: it has no {MANIFEST}") from None
        raise UserError(f"{path}: member {member} is missing; export or download the avatar again") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, MemoryError, RuntimeError) as error:
        raise UserError(f"{path}: {member} cannot be read ({error}); export or download the avatar again") from error


def _open_zip(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except zipfile.BadZipFile:
        with path.open("rb") as file:
            cut = file.read(4) == b"PK\x03\x04"
        reason = "is cut short or damaged" if cut else "is not a gavatar bundle (not a zip)"
        raise UserError(f"{path} {reason}; export or download it again") from None
    except OSError as error:
        raise cannot_read(path, error) from error
