"""An avatar that plays: ONNX Runtime decodes the Gaussians, linear blend skinning carries them into a pose."""

from __future__ import annotations

import os
from time import perf_counter

import numpy as np

from .bundle import Bundle, read_bundle
from .errors import UserError
from .gaussians import Gaussians
from .motion import Motion
from .skeletons import fit_motion, scaled_to_legs
from .skinning import skin
from .surface import positional_map

OUTPUTS = ("offsets", "colors", "scales")


class Avatar:
    """The avatar of a bundle, ready to be posed.

    bundle: an opened `Bundle` or the path of one. threads: of ONNX Runtime within one operator, None for one a core.
    joint_names: of the body, J names. joints: (J, 3) rest joints of its shape, metres. surface: where its N Gaussians
    sit. with_normals: whether `gaussians` shall give normals, for rasterizers that want them.
    stage_seconds: what the last call of `gaussians` spent on `encode`, `decode` and `skin`.
    Raises UserError for a bundle that cannot be read or that ONNX Runtime cannot load.
    """

    def __init__(self, bundle: Bundle | str | os.PathLike, *, threads: int | None = None):
        if threads is not None and threads < 1:
            raise UserError(f"threads={threads}: give a whole number from 1 up")
        self.bundle = bundle if isinstance(bundle, Bundle) else read_bundle(bundle)
        self.name = self.bundle.manifest.name
        self.surface, self._map_surface = self.bundle.surfaces()
        self.joints = self.surface.joints
        self.joint_names = self._read_joint_names()
        self.with_normals = False
        self.stage_seconds: dict[str, float] = {}
        self._encoder = None
        if self.dynamic:
            self._encoder = _Network(self.bundle, "encoder.onnx", ("positional_map",), ("pose_features",), threads)
        inputs = ("pose_features",) if self.dynamic else ()
        self._decoder = _Network(self.bundle, "decoder.onnx", inputs, OUTPUTS, threads)
        self._static: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def __len__(self) -> int:
        """The number of Gaussians."""
        return len(self.surface)

    @property
    def dynamic(self) -> bool:
        """Whether the look depends on the pose."""
        return self.bundle.manifest.dynamic

    def fit(self, motion: Motion) -> tuple[Motion, tuple[str, ...]]:
        """The motion brought to this body's joints, and the names of moving joints that the body lacks.

        Raises UserError for a NaN or infinite pose or translation.
        """
        motion, ignored = fit_motion(motion, self.joint_names)
        motion = scaled_to_legs(motion, self.joint_names, self.joints)
        for key, array in (("pose", motion.poses), ("translation", motion.trans)):
            bad = ~np.isfinite(array.reshape(len(array), -1)).all(1)
            if bad.any():
                raise UserError(f"motion '{motion.name}' has a NaN or infinite {key} at frame {int(np.argmax(bad))}")
        return motion, ignored

    def gaussians(self, pose: np.ndarray, trans: np.ndarray | None = None) -> Gaussians:
        """The avatar in one pose.

        pose: (J, 3) axis-angle relative to the parent joint, radians; with another number of joints it is fitted as
        `fit` does. trans: (3,) metres, zero if None. Returns N isotropic Gaussians in the world, float32, opaque.
        Raises UserError for a NaN or infinite pose.
        """
        pose = np.asarray(pose, np.float32)
        if pose.ndim != 2 or pose.shape[1] != 3:
            raise ValueError(f"pose has shape {pose.shape}, expected (J, 3)")
        trans = np.zeros(3, np.float32) if trans is None else np.asarray(trans, np.float32)
        if len(pose) != len(self.joint_names):
            pose = fit_motion(Motion(pose[None], trans[None], 1.0), self.joint_names)[0].poses[0]
        self._check_finite(pose, trans)

        start = perf_counter()
        features = self._encode(pose)
        encoded = perf_counter()
        points, colors, scales = self._decode(features)
        decoded = perf_counter()
        A = self.surface.skin_transforms(pose)
        A[:, :3, 3] += trans
        means = skin(points, self.surface.joint_index, self.surface.joint_weight, A)
        normals = None
        if self.with_normals:  # those of the body's surface; blending rotations shortens them, never lengthens
            A[:, :3, 3] = 0
            normals = skin(self.surface.normals, self.surface.joint_index, self.surface.joint_weight, A)
        self.stage_seconds = {
            "encode": encoded - start,
            "decode": decoded - encoded,
            "skin": perf_counter() - decoded,
        }
        return Gaussians(means=means, scales=scales, colors=colors, normals=normals)

    def _encode(self, pose: np.ndarray) -> np.ndarray | None:
        if self._encoder is None:
            return None
        image = positional_map(self._map_surface, pose)
        return self._encoder(np.ascontiguousarray(image.transpose(2, 0, 1)[None]))[0]

    def _decode(self, features: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Canonical points (N, 3), colours (N, 3), scales (N,); of a static avatar always the same arrays."""
        if self._static is not None:
            return self._static
        offsets, colors, scales = self._decoder(*(() if features is None else (features,)))
        N = len(self)
        if (offsets.shape, colors.shape, scales.shape) != ((N, 3), (N, 3), (N,)):
            raise UserError(
                f"{self.bundle.path}: decoder.onnx returns shapes {offsets.shape}, {colors.shape} and {scales.shape} "
                f"for {N} Gaussians; export the avatar again"
            )
        decoded = (self.surface.points + offsets, colors, scales)
        if not self.dynamic:
            self._static = decoded
            self._decoder = None  # its weights are of no more use
        return decoded

    def _check_finite(self, pose: np.ndarray, trans: np.ndarray) -> None:
        bad = ~np.isfinite(pose).all(1)
        if bad.any():
            raise UserError(f"the pose of joint '{self.joint_names[int(np.argmax(bad))]}' is NaN or infinite")
        if not np.isfinite(trans).all():
            raise UserError("the translation is NaN or infinite")

    def _read_joint_names(self) -> tuple[str, ...]:
        names = tuple(str(name) for name in self.bundle.arrays("body.npz").get("joint_names", ()))
        if len(names) != self.surface.num_joints:
            raise UserError(
                f"{self.bundle.path}: body.npz names {len(names)} joints and surface.npz has "
                f"{self.surface.num_joints}; export the avatar again"
            )
        return names


class _Network:
    """An ONNX member as a function of arrays, its inputs and outputs checked by name."""

    def __init__(self, bundle: Bundle, member: str, inputs: tuple[str, ...], outputs: tuple[str, ...], threads):
        import onnxruntime  # a tenth of a second that reading a manifest need not pay

        options = onnxruntime.SessionOptions()
        options.inter_op_num_threads = 1
        if threads is not None:
            options.intra_op_num_threads = threads
        # idle workers would spin on the cores that skinning and splatting need next
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        data = bundle.read(member)
        try:
            self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # ONNX Runtime's exceptions have no common base but this
            cause = str(error).strip().splitlines()[0]
            version = onnxruntime.__version__
            raise UserError(f"{bundle.path}: ONNX Runtime {version} cannot load {member}: {cause}") from error
        found = tuple(x.name for x in self._session.get_inputs())
        missing = set(outputs) - {x.name for x in self._session.get_outputs()}
        if found != inputs or missing:
            raise UserError(
                f"{bundle.path}: {member} has inputs {found} and lacks outputs {sorted(missing)}, expected inputs "
                f"{inputs} and outputs {outputs}; export the avatar again"
            )
        self._inputs, self._outputs = inputs, list(outputs)

    def __call__(self, *arrays: np.ndarray) -> list[np.ndarray]:
        return self._session.run(self._outputs, dict(zip(self._inputs, arrays, strict=True)))
