"""Plays .glb files as an independent reader sees them."""

import numpy as np
import pygltflib
from scipy.spatial.transform import Rotation


class Player:
    """Plays a .glb file, by pygltflib's reading of it and SciPy's rotations."""

    def __init__(self, path):
        self.file = pygltflib.GLTF2().load(str(path))
        self.blob = self.file.binary_blob()
        self.parents = {c: i for i, n in enumerate(self.file.nodes) for c in n.children or ()}
        self.curves = {}
        for channel in self.file.animations[0].channels if self.file.animations else ():
            sampler = self.file.animations[0].samplers[channel.sampler]
            assert sampler.interpolation == "LINEAR"
            keys, values = self.numbers(sampler.input), self.numbers(sampler.output)
            self.curves[channel.target.node, channel.target.path] = keys, values

    def numbers(self, accessor: int) -> np.ndarray:
        entry = self.file.accessors[accessor]
        view = self.file.bufferViews[entry.bufferView]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry.type]
        dtype = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}[entry.componentType]
        start, count = (view.byteOffset or 0) + (entry.byteOffset or 0), entry.count * width
        return np.frombuffer(self.blob, dtype, count, start).reshape(entry.count, width)

    def local(self, node: int, key: int | None) -> np.ndarray:
        """(4, 4) of a node at a key frame, or as it rests."""
        entry = self.file.nodes[node]
        place, turn = entry.translation or [0, 0, 0], entry.rotation or [0, 0, 0, 1]
        if key is not None:
            place = self.curves.get((node, "translation"), (0, {key: place}))[1][key]
            turn = self.curves.get((node, "rotation"), (0, {key: turn}))[1][key]
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(turn).as_matrix(), place
        return matrix

    def world(self, node: int, key: int | None) -> np.ndarray:
        matrix = self.local(node, key)
        while node in self.parents:
            node = self.parents[node]
            matrix = self.local(node, key) @ matrix
        return matrix

    def node(self, name: str) -> int:
        return next(i for i, node in enumerate(self.file.nodes) if node.name == name)

    def attribute(self, name: str) -> np.ndarray:
        """(V, C) numbers of the mesh."""
        return self.numbers(getattr(self.file.meshes[0].primitives[0].attributes, name))

    def vertices(self, key: int | None) -> np.ndarray:
        """(V, 3) of the mesh where its joints carry it, by the file's own numbers."""
        skin, rest = self.file.skins[0], self.attribute("POSITION")
        binds = self.numbers(skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
        moves = np.array([self.world(j, key) @ b for j, b in zip(skin.joints, binds, strict=True)])
        homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], 1)
        blended = np.einsum(
            "vk,vkij->vij", self.attribute("WEIGHTS_0"), moves[self.attribute("JOINTS_0")]
        )
        return np.einsum("vij,vj->vi", blended, homogeneous)[:, :3]
