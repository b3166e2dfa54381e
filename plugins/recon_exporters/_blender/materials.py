"""Materials and meshes, by the few calls that all Blenders from 3.4 on share."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

Color = tuple[float, float, float]


def from_hex(text: str) -> Color:
    """Linear red, green, blue of "#rrggbb". IEC 61966-2-1."""
    red, green, blue = (_linear(int(text[at : at + 2], 16) / 255.0) for at in (1, 3, 5))
    return red, green, blue


def _linear(value: float) -> float:
    return float(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4)


def _empty(name: str, color: Color) -> tuple[Any, Any]:
    """A material and the socket that its surface goes into."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    made.diffuse_color = (*color, 1.0)  # what the workbench shows
    made.node_tree.nodes.clear()
    return made, made.node_tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"]


def solid(name: str, color: Color, *, roughness: float = 0.5, metallic: float = 0.0) -> Any:
    """A surface that the sun lights."""
    made, surface = _empty(name, color)
    shader = made.node_tree.nodes.new("ShaderNodeBsdfPrincipled")
    for socket, value in (("Base Color", (*color, 1.0)), ("Roughness", roughness), ("Metallic", metallic)):
        shader.inputs[socket].default_value = value
    made.node_tree.links.new(shader.outputs[0], surface)
    return made


def glowing(name: str, color: Color, strength: float = 1.0) -> Any:
    """A surface of one colour under any light."""
    made, surface = _empty(name, color)
    shader = made.node_tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value = (*color, 1.0)
    shader.inputs["Strength"].default_value = strength
    made.node_tree.links.new(shader.outputs[0], surface)
    return made


def translucent(name: str, color: Color, opacity: float) -> Any:
    """A surface of one colour that lets through what lies behind."""
    made, surface = _empty(name, color)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    mix, clear, tint = (nodes.new(f"ShaderNode{kind}") for kind in ("MixShader", "BsdfTransparent", "Emission"))
    mix.inputs[0].default_value = opacity
    tint.inputs["Color"].default_value = (*color, 1.0)
    links.new(clear.outputs[0], mix.inputs[1])
    links.new(tint.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], surface)
    made.diffuse_color = (*color, opacity)
    if bpy.app.version < (4, 2, 0):
        made.blend_method = "BLEND"
    return made


def checkered(name: str, first: Color, second: Color, size: float) -> Any:
    """A matt surface of squares of `size` m, by which the eye sees motion; seen from above, whatever the height."""
    made = solid(name, first, roughness=0.95)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    place, level, squares = (nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "Mapping", "TexChecker"))
    level.inputs["Location"].default_value, level.inputs["Scale"].default_value = (0.0, 0.0, 0.5), (1.0, 1.0, 0.0)
    squares.inputs["Color1"].default_value = (*first, 1.0)
    squares.inputs["Color2"].default_value = (*second, 1.0)
    squares.inputs["Scale"].default_value = 1.0 / size
    links.new(place.outputs["Object"], level.inputs["Vector"])
    links.new(level.outputs[0], squares.inputs["Vector"])
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    links.new(squares.outputs["Color"], shader.inputs["Base Color"])
    return made


def thing(collection: Any, name: str, data: Any, parent: Any = None) -> Any:
    """An object in the collection; data : mesh, curve, camera, light, None for an empty."""
    made = bpy.data.objects.new(name, data)
    collection.objects.link(made)
    made.parent = parent
    return made


def mesh(name: str, vertices: Any, faces: Any, materials: Any, *, which: Any = None, smooth: bool = False) -> Any:
    """A mesh.

    vertices : (n, 3) m; faces : (k, m) or a list of tuples of vertices; materials : one or several
    which : (k,) number of each face's material
    """
    made = bpy.data.meshes.new(name)
    made.from_pydata(np.asarray(vertices).tolist(), [], faces.tolist() if isinstance(faces, np.ndarray) else faces)
    for material in materials:
        made.materials.append(material)
    if which is not None:
        made.polygons.foreach_set("material_index", np.asarray(which, dtype=np.int32))
    if smooth:
        made.polygons.foreach_set("use_smooth", np.ones(len(made.polygons), dtype=bool))
    made.update()
    return made


def grid_faces(rows: int, columns: int, *, closed: bool = False) -> Any:
    """Quads between the vertices of a grid, row by row; closed : the last column joins the first: (k, 4)."""
    number = np.arange(rows * columns).reshape(rows, columns)
    if closed:
        number = np.column_stack((number, number[:, 0]))
    corners = (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    return np.stack([corner.ravel() for corner in corners], axis=1)
